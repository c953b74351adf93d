r"""
103: Rendering with Mitsuba
===========================

A Wigner function lives on rays: it is a radiance. So a path tracer that knows nothing of
diffraction can carry it into a scene, and draw lobes, nulls and shadows. In this lesson you build
a scene from nothing, as a dictionary and as XML, compare what is rendered with a formula, and
find out which part of a picture is noise.
"""

# Before anything else loads Dr.Jit: it looks for an LLVM library that works.
import polywigner.mitsuba  # isort: skip

import time
from pathlib import Path

import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np

import polywigner as pw
from polywigner.figures import image_peak, level_db

mi.set_variant(polywigner.mitsuba.choose_variant())
print(mi.variant())

# %%
# A scene in a dictionary
# -----------------------
# The square of 10 mm at 94 GHz hangs 0.3 m above a white floor and looks down. An aperture lies
# in its own plane :math:`z = 0` and radiates to its :math:`+z`, so it is turned by 180 degrees
# about x, and lifted. Everything else is plain Mitsuba. The camera looks straight down with
# parallel rays, so that pixels are places on the floor; it starts below the patch, which is
# transparent to it but would cost rays a bounce.

WAVELENGTH = 299_792_458 / 94e9
HEIGHT, HALF, ALBEDO, PIXELS = 0.3, 0.45, 0.5, 96
patch = pw.shapes.square(10e-3)
transform = mi.ScalarTransform4f


def scene_with(sampler, **more):
    """The patch over the floor, seen from above."""
    down = transform().translate([0, 0, HEIGHT]).rotate([1, 0, 0], 180)
    from_above = transform().look_at([0, 0, 0.25], [0, 0, 0], [0, 1, 0])
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},  # light that is reflected once
            "patch": polywigner.mitsuba.aperture(patch, WAVELENGTH, to_world=down),
            "floor": {
                "type": "rectangle",
                "to_world": transform().scale(0.6),
                "bsdf": {
                    "type": "diffuse",
                    "reflectance": {"type": "spectrum", "value": ALBEDO},
                },
            },
            "camera": {
                "type": "orthographic",
                "to_world": from_above @ transform().scale([HALF, HALF, 1]),
                "film": {
                    "type": "hdrfilm",
                    "width": PIXELS,
                    "height": PIXELS,
                    "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                },
                "sampler": {"type": sampler},
            },
            **more,
        }
    )


start = time.perf_counter()
radiance = polywigner.mitsuba.render(scene_with("multijitter"), spp=256)[..., 0]
print(f"{time.perf_counter() - start:.1f} s, of which most is compiling")

# %%
# What comes back is radiance in W/(m² sr), with its sign: :math:`W` is negative in places, and so
# are single pixels, where the sum over the aperture has not come out quite. **Never** take the
# logarithm of raw pixels. A picture in dB needs a reference and a floor; ``image_peak`` is the
# largest median over three by three pixels, because the largest single pixel of a Monte Carlo
# picture is its noisiest.

print(f"pixels from {radiance.min():.1e} to {radiance.max():.1e} W/(m² sr)")
assert radiance.min() < 0


def show(axes, values, reference, floor, title, **box):
    """Signed radiance in dB; what is not above the floor, or negative, has its colour."""
    picture = axes.imshow(level_db(values, reference, floor), "inferno", vmin=floor, vmax=0, **box)
    axes.set(title=title, xlabel="x (mm)")
    axes.figure.colorbar(picture, ax=axes, label="dB rel. to the peak")


PLACES = {"extent": 2 * [-HALF * 1e3, HALF * 1e3]}  # mm
figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
show(axes, radiance, image_peak(radiance), -40, "the floor, from above", **PLACES)
axes.set_ylabel("y (mm)")

# %%
# What should be there
# --------------------
# The floor is far away in terms of the aperture, :math:`a^2/\lambda = 31` mm, so a formula knows
# the answer: the power that comes in is :math:`E = |F(\nu)|^2\cos^5\theta/(\lambda h)^2`, with
# :math:`\nu = \sin\theta/\lambda` along each axis and :math:`\cos\theta = h/r`, and a diffuse
# floor of albedo :math:`\varrho` sends back the radiance :math:`\varrho E/\pi`. (Two cosines for
# the obliquity of Rayleigh and Sommerfeld's first integral, two for the distance, one for the
# floor, which light meets at an angle; see :doc:`/docs/theory`.)

axis = (np.arange(PIXELS) + 0.5) / PIXELS * 2 * HALF - HALF
oversampled = (axis[:, None] + np.linspace(-0.5, 0.5, 9)[None, 1::2] * 2 * HALF / PIXELS).ravel()
place = np.stack(np.meshgrid(oversampled, oversampled), axis=-1)
r = np.sqrt(np.sum(place**2, axis=-1) + HEIGHT**2)
power = np.abs(pw.fourier(patch, place / r[..., None] / WAVELENGTH)) ** 2
expected = ALBEDO / np.pi * power * (HEIGHT / r) ** 5 / (WAVELENGTH * HEIGHT) ** 2
expected = expected.reshape(PIXELS, 4, PIXELS, 4).mean(axis=(1, 3))  # pixels are means

peak = expected.max()
difference = radiance - expected
bias = difference[expected > peak / 2].mean() / peak
print(f"in the main lobe, rendered less expected: {bias:+.4f} of the peak in the mean")
assert abs(bias) < 0.003

figure, panels = plt.subplots(1, 3, figsize=(10, 3), layout="compressed")
show(panels[0], radiance, peak, -40, "rendered", **PLACES)
show(panels[1], expected, peak, -40, "formula", **PLACES)
limit = 0.01
picture = panels[2].imshow(difference / peak, "RdBu_r", vmin=-limit, vmax=limit, **PLACES)
panels[2].set(title="difference", xlabel="x (mm)")
panels[0].set_ylabel("y (mm)")
figure.colorbar(picture, ax=panels[2], extend="both", label="of the peak")

# %%
# What is noise
# -------------
# There are specks between the lobes of the rendered picture, and lobes are grainy. What of a
# picture is noise, and what is there? Two renders that differ in nothing but their seed tell:
# what is in the scene is in both. Half of the mean square of their difference is the variance of
# one of them. No formula is needed for that, so it works in any scene.


def noise(scene, spp):
    """Root mean square of the noise, and of the error against the formula, over the peak."""
    one, two = (polywigner.mitsuba.render(scene, spp=spp, seed=s)[..., 0] for s in (1, 2))
    error = np.sqrt(np.mean((one - expected) ** 2)) / peak
    return np.sqrt(np.mean((one - two) ** 2) / 2) / peak, error


counts = [16, 64, 256]
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
result = {}
for sampler, marker in (("independent", "o"), ("multijitter", "s")):
    scene = scene_with(sampler)
    result[sampler] = np.array([noise(scene, spp) for spp in counts])
    db = 10 * np.log10(result[sampler])
    axes.semilogx(counts, db[:, 0], marker + "-", label=f"{sampler}: two seeds")
    axes.semilogx(counts, db[:, 1], marker + "--", mfc="none", label=f"{sampler}: against formula")
axes.set(xlabel="samples per pixel", ylabel="rms over the peak (dB)")
axes.set_xticks(counts, map(str, counts))
axes.minorticks_off()
axes.legend()
for sampler, values in result.items():
    print(sampler, "  ".join(f"{10 * np.log10(v):.1f} dB" for v in values[:, 0]))

independent, multijitter = result["independent"][:, 0], result["multijitter"][:, 0]
assert 0.4 < independent[1] / independent[0] < 0.6  # four times the samples, half the noise
assert multijitter[2] < independent[2] / 5  # 7 dB and more, for nothing

# %%
# Three things to take along. Independent samples gain 3 dB for four times the work (dB of the
# radiance: half the amplitude of the noise). ``multijitter`` spreads the samples of a pixel over
# the aperture evenly, and gains more with every one: take it always. And the two curves of a
# sampler, from two seeds and against the formula, lie on each other as long as noise is all that
# is wrong: the noise seen by two seeds is an honest figure, and the **floor of a picture should
# not lie far below it**. Here is where 16 independent samples let you look, and where not:

noisy = polywigner.mitsuba.render(scene_with("independent"), spp=16)[..., 0]
seen = 10 * np.log10(independent[0])
print(f"floor for this picture: {seen:.0f} dB")
figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), layout="compressed")
for axes, floor in zip(panels, (-40, round(seen)), strict=True):
    show(axes, noisy, peak, floor, f"16 independent samples, floor −{-floor} dB", **PLACES)
panels[0].set_ylabel("y (mm)")

# %%
# The same in XML
# ---------------
# The plugin is a shape named ``wigner``; a scene in XML is what ``polywigner render scene.xml``
# takes. Its outline comes from a file, units are written out, and a ball throws a shadow. Shadows
# are geometric: the ball cuts rays off, and does not diffract.

XML = """
<scene version="3.0.0">
    <integrator type="path"> <integer name="max_depth" value="3"/> </integrator>
    <sensor type="perspective">
        <float name="fov" value="36"/>
        <transform name="to_world">
            <lookat origin="0, -0.85, 1.4" target="0, -0.02, 0" up="0, 0, 1"/>
        </transform>
        <sampler type="multijitter"> <integer name="sample_count" value="144"/> </sampler>
        <film type="hdrfilm">
            <integer name="width" value="160"/> <integer name="height" value="128"/>
            <string name="pixel_format" value="luminance"/> <rfilter type="box"/>
        </film>
    </sensor>
    <shape type="wigner">
        <string name="aperture" value="$outline"/>
        <string name="unit" value="mm"/>
        <string name="frequency" value="94 GHz"/>
        <transform name="to_world"> <rotate x="1" angle="180"/> <translate z="0.3"/> </transform>
    </shape>
    <shape type="rectangle"> <transform name="to_world"> <scale value="0.6"/> </transform> </shape>
    <shape type="sphere">
        <point name="center" x="0.11" y="-0.05" z="0.05"/> <float name="radius" value="0.05"/>
    </shape>
</scene>
"""
outline = Path("../patch_above_floor/patch.geojson").resolve()
picture = polywigner.mitsuba.render(mi.load_string(XML, outline=str(outline)))[..., 0]
figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
show(axes, picture, image_peak(picture), -35, "a ball in the beam")
axes.set_axis_off()

# %%
# Exercises
# ---------
# 1. Lift the patch until the floor is at 2, 5 and 30 wavelengths. From where on is the formula
#    right? (The far field begins near :math:`a^2/\lambda`; what a renderer does nearer than that
#    is :doc:`lesson 105 <lesson_105_near_field>`.)
# 2. Give the patch a taper: ``patch.with_illumination(pw.cosine_taper(10e-3, 10e-3))``. Where are
#    the sidelobes?
# 3. Set ``obliquity="rayleigh-sommerfeld-2"``. By which power of the cosine does the picture
#    change, and how much is that at its rim?
# 4. Replace the patch by the two chevrons of :doc:`lesson 102 <lesson_102_phase_space>`. How many
#    more samples does the same noise take? Why is that so, in terms of the middle of the
#    automean?
