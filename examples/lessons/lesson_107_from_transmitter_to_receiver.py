r"""
107: From transmitter to receiver
=================================

How many of a transmitter's watts does a receiver get? Far away Friis' formula tells. This lesson
starts there, comes nearer until the formula ends, tilts and shifts the antennas, focuses an array
on a receiver, and at last puts both into a scene, where light from walls and floors arrives as
well. Each number is found by a second route too.
"""

# Before anything else loads Dr.Jit: it looks for an LLVM library that works.
import polywigner.mitsuba  # isort: skip

import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np

import polywigner as pw

mi.set_variant(polywigner.mitsuba.choose_variant())


def decibels(power):
    """10 log10 of a ratio of powers."""
    return 10 * np.log10(power)


# %%
# Friis, and where it ends
# ------------------------
# A link is two sources and a pose. The receiver is described by the field that it would send, on
# its own plane, and sends along its own +z. ``to_transmitter`` maps its frame into the
# transmitter's: here it hangs at a distance on the axis, turned round so that both face each other.

WAVELENGTH = 299_792_458 / 94e9
SIDE = 10e-3
square = pw.shapes.square(SIDE)


def facing(distance, shift=0.0, tilt=0.0):
    """Poses of a receiver that looks back; shifted along x, and turned about its own y."""
    distance, shift, tilt = np.broadcast_arrays(distance, shift, tilt)
    poses = np.zeros((*distance.shape, 4, 4))
    poses[..., 0, 0], poses[..., 0, 2] = -np.cos(tilt), np.sin(tilt)
    poses[..., 2, 0], poses[..., 2, 2] = -np.sin(tilt), -np.cos(tilt)
    poses[..., 1, 1] = poses[..., 3, 3] = 1
    poses[..., 0, 3], poses[..., 2, 3] = shift, distance
    return poses


# %%
# ``pw.coupling`` gives the complex amplitude b of the link, and :math:`|b|^2` is the received over
# the radiated power. ``"fraunhofer"`` is Friis' formula, with the directivity G of
# ``pw.radiation_pattern`` for both antennas. The number that decides is :math:`N = A/(\lambda z)`
# for the area A of both squares: on the axis, Friis says :math:`(G\lambda/4\pi z)^2 = (N/\eta)^2`,
# where :math:`\eta` is the share of :math:`\int|u|^2` that a square radiates.

share = pw.radiated_power(square, WAVELENGTH) / square.area
pattern = pw.radiation_pattern(square, WAVELENGTH, 0.0, 0.0)
print(f"it radiates {share:.3f}; {pattern.attrs['largest_directivity']:.2f} dBi")

distance = np.geomspace(6e-3, 3, 120)
exact = np.abs(pw.coupling(square, square, facing(distance), WAVELENGTH)) ** 2
friis = np.abs(pw.coupling(square, square, facing(distance), WAVELENGTH, method="fraunhofer")) ** 2

figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
axes.semilogx(distance * 1e3, decibels(exact), label="exact")
axes.semilogx(distance * 1e3, decibels(friis), "--", label="Friis")
axes.axvline(SIDE**2 / (0.5 * WAVELENGTH) * 1e3, color="black", linewidth=0.6)
axes.text(64, 8, "N = 0.5")
axes.set(
    xlabel="distance (mm)",
    ylabel="received / transmitted (dB)",
    title="Two squares of 10 mm at 94 GHz, face to face",
    ylim=(-45, 16),
)
axes.legend()
gain = 10 ** (pattern.attrs["largest_directivity"] / 10)
assert np.allclose(friis, (gain * WAVELENGTH / (4 * np.pi * distance)) ** 2, rtol=1e-6)
assert np.allclose(friis, (SIDE**2 / (WAVELENGTH * distance) / share) ** 2, rtol=1e-6)

# %%
# Friis promises more than everything as soon as N exceeds 0.9. The truth bends over. At N = 0.5
# it is 0.9 dB below, and at N = 0.1 four hundredths:

loss = {}
for n in (0.5, 0.1):
    pose = facing(SIDE**2 / (n * WAVELENGTH))
    near = abs(pw.coupling(square, square, pose, WAVELENGTH))
    far = abs(pw.coupling(square, square, pose, WAVELENGTH, method="fraunhofer"))
    levels = decibels(near**2), decibels(far**2)
    loss[n] = levels[1] - levels[0]
    print(f"N = {n}: exact {levels[0]:.3f} dB, Friis {levels[1]:.3f} dB")
assert abs(loss[0.5] - 0.91) < 0.01
assert loss[0.1] < 0.05

# %%
# The second route. A receiver adds up the field that arrives, with the weight of the field that it
# would send. For the second integral of Rayleigh and Sommerfeld, which has no cosines, that is all
# there is to it: fields from ``pw.amplitude`` at Gauss's nodes on the receiver, added up, over the
# roots of both radiated powers.

nodes, weights = np.polynomial.legendre.leggauss(24)
x, y = np.meshgrid(SIDE / 2 * nodes, SIDE / 2 * nodes)
places = np.stack([x, y, np.full_like(x, 62.7e-3)], axis=-1)
field = pw.amplitude(square, places, WAVELENGTH, "rayleigh-sommerfeld-2", tolerance=1e-10)
radiated = pw.radiated_power(square, WAVELENGTH, "rayleigh-sommerfeld-2")
added = (SIDE / 2) ** 2 * (weights @ field @ weights) / radiated
b = pw.coupling(square, square, facing(62.7e-3), WAVELENGTH, "rayleigh-sommerfeld-2")
print(f"added up {added:.9f}, coupling {b:.9f}")
assert abs(added - b) < 1e-8

# %%
# Misalignment
# ------------
# Far away, a tilt takes the receiver through its own pattern, and a shift takes it through both
# patterns at once. Nearer, the nulls of the tilt fill and those of the shift move outwards.

tilt = np.radians(np.linspace(-45, 45, 181))
aside = np.radians(np.linspace(-45, 45, 181))
figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained", sharey=True)
for z, colour in ((62.7e-3, "C0"), (627e-3, "C1")):
    for axes, across, poses in (
        (panels[0], np.degrees(tilt), facing(z, 0.0, tilt)),
        (panels[1], np.degrees(aside), facing(z, z * np.tan(aside))),
    ):
        power = np.abs(pw.coupling(square, square, poses, WAVELENGTH)) ** 2
        label = f"{z * 1e3:.0f} mm" if axes is panels[0] else None
        axes.plot(across, decibels(power / power.max()), colour, label=label)
        if z > 0.5:
            far = np.abs(pw.coupling(square, square, poses, WAVELENGTH, method="fraunhofer")) ** 2
            axes.plot(across, decibels(far / far.max()), "k:", linewidth=1)
            strong = far > far.max() / 100
            assert np.abs(decibels(power / far))[strong].max() < 0.5
panels[0].set(xlabel="tilt of the receiver (degrees)", ylabel="dB below the best", ylim=(-50, 2))
panels[1].set(xlabel="direction of the shifted receiver (degrees)")
figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)

# %%
# The dotted lines are Friis' formula at 627 mm.
#
# An array that charges a receiver
# --------------------------------
# 256 elements in a square of 0.48 m at 5.8 GHz, and a receiver of 0.1 m on the axis. The array is
# focused on a point at 0.8 m by the phases of its elements, or not at all.

LAMBDA, PITCH, FOCUS = 299_792_458 / 5.8e9, 30e-3, 0.8
element, receiver = pw.shapes.square(25e-3), pw.shapes.square(0.1)
sites = pw.arrays.grid_positions(16, 16, PITCH, PITCH)
to_focus = np.hypot(np.linalg.norm(sites, axis=1), FOCUS)
phases = np.exp(-2j * np.pi / LAMBDA * to_focus)
focused = pw.phased_array(element, sites, phases)
plain = pw.phased_array(element, sites)

distance = np.geomspace(0.3, 3, 36)
charging = {
    name: np.abs(pw.coupling(array, receiver, facing(distance), LAMBDA, tolerance=1e-4)) ** 2
    for name, array in (("focused at 0.8 m", focused), ("all in phase", plain))
}
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
for name, power in charging.items():
    axes.plot(distance, 100 * power, label=name)
axes.axvline(FOCUS, color="black", linewidth=0.6)
axes.set(
    xlabel="distance of the receiver (m)",
    ylabel="received / transmitted (%)",
    title="A square of 0.1 m before 16 x 16 elements at 5.8 GHz",
    ylim=(0, None),
)
axes.legend()
best = distance[charging["focused at 0.8 m"].argmax()]
print(f"{100 * charging['focused at 0.8 m'].max():.0f} % at {best:.1f} m")
assert charging["focused at 0.8 m"].max() > 0.74
assert best < FOCUS

# %%
# Three quarters of the power arrive, 14 times as much as without a focus. The best place is
# a little nearer than the focus, as with every focus of few Fresnel zones: the nearer receiver
# covers more of the beam. The second route takes the array apart. Couplings are linear: the sum
# over its elements, each with its weight and its own pose, has to be the whole.

poses = facing(np.full(len(sites), FOCUS))
poses[:, :2, 3] = -sites
parts = pw.coupling(element, receiver, poses, LAMBDA)
powers = [pw.radiated_power(source, LAMBDA) for source in (element, focused)]
summed = np.sum(phases * parts) * np.sqrt(powers[0] / powers[1])
whole = pw.coupling(focused, receiver, facing(FOCUS), LAMBDA)
print(f"sum over elements {summed:.7f}, whole {whole:.7f}")
assert abs(summed - whole) < 2e-6
assert abs(abs(whole) ** 2 - 0.7346) < 0.001

# %%
# A corridor with a rough wall
# ----------------------------
# Now a scene. Transmitter and receiver, squares of 3 mm at 94 GHz, face each other along a corridor
# of 6 m; one of its walls, 1 m aside, is rough and scatters half of what meets it in all directions
# alike. A ``wigner_receiver`` is a sensor with a film of one pixel that reads watts.
# ``received_power`` adds what comes straight, by the coupling of above.

LENGTH, ASIDE, HALF_HEIGHT, ALBEDO = 6.0, 1.0, 1.2, 0.5
patch = pw.shapes.square(3e-3)
transform = mi.ScalarTransform4f
looks_back = transform().translate([0, 0, LENGTH]).rotate([0, 1, 0], 180)
rough = {
    "type": "diffuse",
    "reflectance": {"type": "spectrum", "value": ALBEDO},
}


def received(emitter_pose, receiver_pose, source, samples, **things):
    """The received power in a scene of these things, of 1 W."""
    return polywigner.mitsuba.received_power(
        mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": 2},  # one reflection
                "transmitter": polywigner.mitsuba.aperture(
                    source, WAVELENGTH, to_world=emitter_pose, power=1.0, estimator="exact"
                ),
                "receiver": polywigner.mitsuba.receiver(source, WAVELENGTH, to_world=receiver_pose),
                **things,
            }
        ),
        spp=samples,
    )


wall = {
    "type": "rectangle",
    "to_world": transform()
    .translate([-ASIDE, 0, LENGTH / 2])
    .rotate([0, 1, 0], 90)
    .scale([LENGTH / 2, HALF_HEIGHT, 1]),
    "bsdf": rough,
}
corridor = received(transform(), looks_back, patch, 1 << 18, wall=wall)
print(corridor)

# %%
# The second route for the wall is an integral over it. A patch of the wall that sends the radiance
# L towards the receiver adds :math:`\lambda^2 \cos\theta\, L\, |U_r|^2/N_r` per area, with
# :math:`U_r` the field that the receiver would send there, and
# :math:`L = (\varrho/\pi)\,E` follows from the irradiance :math:`E = |U_t|^2\cos\theta/N_t` of the
# wall. Both N are radiated powers:

radiated = pw.radiated_power(patch, WAVELENGTH)
nodes, weights = np.polynomial.legendre.leggauss(150)
z, y = np.meshgrid(LENGTH / 2 * (1 + nodes), HALF_HEIGHT * nodes)
area = LENGTH / 2 * HALF_HEIGHT * np.outer(weights, weights)


def arriving(along):
    """|U|^2/N on the wall, and the cosines to the wall's normal."""
    points = np.stack([np.full_like(along, -ASIDE), y, along], axis=-1)
    density = pw.irradiance(patch, points, WAVELENGTH, "rayleigh-sommerfeld-1")
    return density / radiated, ASIDE / np.linalg.norm(points, axis=-1)


there, cosine = arriving(z)
back, towards = arriving(LENGTH - z)
radiance = ALBEDO / np.pi * there * cosine
by_wall = WAVELENGTH**2 * np.sum(area * radiance * towards * back)
straight = abs(pw.coupling(patch, patch, facing(LENGTH), WAVELENGTH)) ** 2
print(f"straight {decibels(straight):.2f} dB; wall {decibels(by_wall):.2f} dB by the integral,")
print(f"{decibels(corridor.scattered):.2f} dB by rays, {corridor.standard_error:.1e} W of error")
assert abs(decibels(corridor.direct / straight)) < 1e-3
assert abs(corridor.scattered - by_wall) < 4 * corridor.standard_error
assert corridor.standard_error < 0.01 * by_wall

# %%
# Somebody stands in the middle of the corridor: a plate of 0.2 m, black. The straight path is gone,
# and with it all but the wall's share, 18 dB less.

plate = {
    "type": "rectangle",
    "to_world": transform().translate([0, 0, LENGTH / 2]).scale(0.1),
    "bsdf": {"type": "twosided", "material": rough | {"reflectance": 0.0}},
}
blocked = received(transform(), looks_back, patch, 1 << 18, wall=wall, plate=plate)
print(f"with the plate: {blocked.dbm:.1f} dBm of 30 dBm, without: {corridor.dbm:.1f} dBm")
assert blocked.direct == 0
assert 0.9 < blocked.scattered / by_wall < 1.02

# %%
# There and back again
# --------------------
# The square of 10 mm, 0.3 m above a floor, sends and receives. Each place of the floor counts with
# the fourth power of the field: once for the way there and once for the way back.

HEIGHT, HALF = 0.3, 3.0
floor = {
    "type": "rectangle",
    "to_world": transform().translate([0, 0, HEIGHT]).rotate([1, 0, 0], 180).scale(HALF),
    "bsdf": rough,
}
echo = received(transform(), transform(), square, 1 << 18, floor=floor)

nodes, weights = np.polynomial.legendre.leggauss(200)
angle = np.arctan(HALF / HEIGHT) * nodes  # places that are dense below the square
across = HEIGHT * np.tan(angle)
width = np.arctan(HALF / HEIGHT) * weights * HEIGHT / np.cos(angle) ** 2
x, y = np.meshgrid(across, across)
points = np.stack([x, y, np.full_like(x, HEIGHT)], axis=-1)
radiated = pw.radiated_power(square, WAVELENGTH)
power = pw.irradiance(square, points, WAVELENGTH, "rayleigh-sommerfeld-1") / radiated
cosine = HEIGHT / np.linalg.norm(points, axis=-1)
by_floor = WAVELENGTH**2 * ALBEDO / np.pi * np.sum(np.outer(width, width) * (cosine * power) ** 2)
print(
    f"by rays {echo.power:.3e} W, {echo.standard_error:.1e} W of error; integral {by_floor:.3e} W"
)
assert echo.direct == 0
assert abs(echo.power - by_floor) < 4 * echo.standard_error
assert echo.standard_error < 0.01 * by_floor

# %%
# Where does it come from? A film of many pixels sorts the same power by direction. Its axes are
# direction cosines of the receiver's own frame. Seen along its z axis, its x axis points left.

scene = mi.load_dict(
    {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "transmitter": polywigner.mitsuba.aperture(
            square, WAVELENGTH, power=1.0, estimator="exact", visible=False
        ),
        "receiver": polywigner.mitsuba.receiver(square, WAVELENGTH, film=(96, 96)),
        "floor": floor,
    }
)
arrivals = polywigner.mitsuba.render(scene, spp=64)[..., 0]
print(f"sum over the pixels: {arrivals.sum():.3e} W")
figure, axes = plt.subplots(figsize=(5, 4.2), layout="constrained")
picture = axes.imshow(
    decibels(np.maximum(arrivals / arrivals.max(), 1e-9)),
    "inferno",
    origin="lower",
    extent=(-1, 1, -1, 1),
    vmin=-80,
)
axes.invert_xaxis()
axes.set(xlabel="direction cosine along x", ylabel="along y", title="Echo of a floor 0.3 m away")
figure.colorbar(picture, label="received power per pixel (dB rel. to the peak)")
assert abs(arrivals.sum() / by_floor - 1) < 0.01

# %%
# Exercises
# ---------
# 1. Tilt the receiver of the corridor towards the wall. At which angle does the wall bring most?
# 2. Make the wall of metal, ``{"type": "conductor", "material": "none"}``. What comes by the mirror
#    image, and what does the table say of it?
# 3. Where, between the array of above and its focus, would you put a receiver of 0.3 m? Does the
#    array's focus still help there?
# 4. Fill the corridor with fog (a ``homogeneous`` medium and ``volpath``). How much of the power
#    arrives from fog alone?
