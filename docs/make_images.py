"""Make the pictures of the README and the examples: ``python docs/make_images.py [NAME ...]``.

Renders every example with its own settings (a few minutes), and reduces the results to what a page
needs: at most 860 pixels wide and 300 KiB; for the README, three of them to 560 pixels.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from itertools import chain
from pathlib import Path
from typing import Any, cast

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import polywigner as pw
from polywigner.cli import main as polywigner
from polywigner.figures import draw_projections, draw_tolerance
from polywigner.figures.style import BLUE, GREEN, RED, draw_disc, floor_text

ROOT = Path(__file__).parent.parent
EXAMPLES = ROOT / "examples"
IMAGES = Path(__file__).parent / "images"
WIDEST = 860  # pixels
LARGEST = 300  # KiB
SMALLER = {
    "two_chevrons_volume": 195,
    "paper_emitters": 220,
}  # KiB, of pictures that lose nothing by it

CHEVRONS = EXAMPLES / "two_chevrons" / "chevrons.geojson"
BODIES = EXAMPLES / "shadows_of_bodies"
VOLUME = {
    "--frequency": "94 GHz",
    "--method": "rayleigh-sommerfeld-1",
    "--accuracy": "1e-4",
    "--precision": "single",
    "--box": "-36 mm to 36 mm, -36 mm to 36 mm, 2 mm to 120 mm",
    "--shape": "97 x 97 x 119",
}
# As the pages of the examples have it.
FLOOR = dict.fromkeys(("phased_array_77ghz", "focused_array", "te10_horn"), ("--db-floor", "-30"))
COMMANDS = {
    "two_chevrons_volume": ["volume", str(CHEVRONS), *chain.from_iterable(VOLUME.items())],
    "two_chevrons_transforms": ["transform", str(CHEVRONS), "--frequency", "94 GHz"],
    "hard_plate": [
        "propagate",
        str(BODIES / "patch.wkt"),
        "--frequency",
        "94 GHz",
        "--plane",
        "-80 mm to 80 mm, 0 mm, 20 mm to 260 mm",
        "--samples",
        "161 x 241",
        "--obstacle",
        f"{BODIES / 'plate.wkt'} at 0 mm, 0 mm, 80 mm towards 35 deg, 180 deg",
        "--edge",
        "hard",
    ],
    "behind_obstacles": [
        "propagate",
        str(BODIES / "patch.wkt"),
        "--frequency",
        "94 GHz",
        "--plane",
        "-80 mm to 80 mm, 0 mm, 20 mm to 260 mm",
        "--samples",
        "161 x 241",
        "--obstacle",
        str(BODIES / "box.obj"),
        "--obstacle",
        f"{BODIES / 'plate.wkt'} at -40 mm, 0 mm, 60 mm towards 35 deg, 180 deg",
    ],
    "diffraction_in_scenes": [
        "render",
        str(EXAMPLES / "patch_above_floor" / "scene.xml"),
        "--diffraction",
        *("--integrator", "direct", "--spp", "9"),
    ],
    "street_diffraction": [
        "render",
        str(EXAMPLES / "street_77ghz" / "scene.xml"),
        "--diffraction",
        *("--integrator", "direct", "--spp", "4"),
    ],
    **{  # two of the pictures of one command
        f"wet_street_{kind}": [
            "render",
            str(EXAMPLES / "wet_street" / "street.xml"),
            *("--polarised", "--spp", "144"),
        ]
        for kind in ("stokes", "polarisation")
    },
    "link_77ghz": ["receive", str(EXAMPLES / "link_77ghz" / "link.xml")],
    **{
        path.parent.name: ["render", str(path), *FLOOR.get(path.parent.name, ())]
        for path in sorted(EXAMPLES.glob("*/scene.xml"))
    },
}
README = ("patch_above_floor", "diffraction_in_scenes", "first_picture", "two_chevrons_volume")
README_WIDTH = 560
SCRIPTS = (
    "inverse_design",
    "fractional_fourier",
    "spatial_filter",
    "shadow_of_a_plate",
    "shadows_of_bodies",
    "partial_coherence",
    "corner_reflector",
    "corner_above_road",
    "koehler_illumination",
)
"""Examples that write NAME.png into a folder."""
PAPER = ("render", "amp_spec", "error", "emitters")  # of `make paper-figures`, for docs/figures.md


def main(names: list[str]) -> None:
    IMAGES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        near = ["near_field_boresight", "near_field_off_axis"]
        paper = [f"paper_{name}" for name in PAPER]
        for name in names or [*MAKERS, *SCRIPTS, *near, *paper, *COMMANDS]:
            if name in MAKERS:
                made = MAKERS[name](Path(folder))
            elif name in SCRIPTS:
                made = by_script(name, Path(folder))
            elif name in near:
                made = near_field(Path(folder)) / f"{name.removeprefix('near_field_')}.png"
            elif name in paper:
                figure = name.removeprefix("paper_")
                made = Path(folder) / f"{figure}.png"
                command = [sys.executable, "-m", "paper.figures", figure, "--quality", "print"]
                subprocess.run([*command, "--out", folder], cwd=ROOT, check=True)
            else:
                made = Path(folder) / f"{name}.png"
                stem = name.removesuffix("_stokes").removesuffix("_polarisation")
                if polywigner([*COMMANDS[name], "--out", str(Path(folder) / stem)]) != 0:
                    sys.exit(f"{name} failed")
            reduce(made, IMAGES / f"{name}.png", SMALLER.get(name, LARGEST))
            if name in README:
                small(IMAGES / f"{name}.png", IMAGES / f"small_{name}.png")


def first_picture(folder: Path) -> Path:
    script = EXAMPLES / "first_picture.py"
    environment = {**os.environ, "MPLBACKEND": "agg"}
    subprocess.run([sys.executable, str(script)], cwd=folder, env=environment, check=True)
    return folder / "wigner.png"


def estimators(folder: Path) -> Path:
    """A floor 60 mm below a square, shaded by a plate and a post, as both estimators have it."""
    import mitsuba as mi

    import polywigner.mitsuba as pwm
    from polywigner.figures import level_db

    mi.set_variant(pwm.choose_variant())
    samples = {"wigner": 1024, "exact": 64}
    seen = {
        name: pwm.render(mi.load_dict(shaded_floor(name)), spp=spp)[::-1, ::-1, 0].astype(float)
        for name, spp in samples.items()
    }
    size = seen["exact"].shape[0]
    millimetres = (np.arange(size) + 0.5) * 160 / size - 80
    peak = seen["exact"].max()
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.9), layout="constrained")
    for panel, (name, picture) in zip(axes, seen.items(), strict=False):
        shown = panel.imshow(
            level_db(picture, peak, -40), "inferno", vmin=-40, vmax=0, origin="lower",
            extent=[-80, 80, -80, 80],
        )  # fmt: skip
        panel.set(title=f'"{name}", {samples[name]} samples', xlabel="x (mm)", ylabel="y (mm)")
    figure.colorbar(shown, ax=axes[:2], label="dB below the peak")
    row = size // 2 + 3
    for name, picture in seen.items():
        axes[2].plot(millimetres, picture[row] / peak, label=f'"{name}"', lw=1.2)
    axes[2].set(title="along y = 2 mm", xlabel="x (mm)", ylabel="radiance over the peak")
    axes[2].set_ylim(-0.05, 0.12)
    axes[2].axhline(0, color="0.6", lw=0.6)
    axes[2].grid(alpha=0.3)
    axes[2].legend()
    figure.savefig(folder / "estimators.png", dpi=110)
    return folder / "estimators.png"


def ranges(folder: Path) -> Path:
    """The street by range: six bins of a metre."""
    import mitsuba as mi

    import polywigner.mitsuba as pwm
    from polywigner.figures import image_peak, level_db

    scene = pwm.load_scene(EXAMPLES / "street_77ghz" / "scene.xml", pwm.choose_variant())
    camera = mi.traverse(scene.sensors()[0])
    camera["film.size"] = (256, 192)
    camera.update()
    frames = pwm.range_frames(scene, np.arange(6.0, 22.0), spp=64)["radiance"].values
    peak = max(image_peak(frame) or 0.0 for frame in frames)
    figure, axes = plt.subplots(2, 3, figsize=(9, 4.6), layout="constrained")
    for panel, first in zip(axes.flat, (7, 9, 10, 12, 14, 18), strict=True):
        levels = level_db(frames[first - 6], peak, -40)
        shown = panel.imshow(levels, "inferno", vmin=-40, vmax=0)
        panel.set_title(f"{first} to {first + 1} m", fontsize=9)
        panel.set_axis_off()
    figure.colorbar(shown, ax=axes, label="radiance, dB below the peak of all bins")
    figure.savefig(folder / "ranges.png", dpi=110)
    return folder / "ranges.png"


def shaded_floor(estimator: str) -> dict:
    """In millimetres, seen from above; the plate stands at x > 8 mm, the post at x = -20 mm."""
    import mitsuba as mi

    import polywigner.mitsuba as pwm

    move = mi.ScalarTransform4f()
    down = move.translate([0, 0, 60]).rotate([1, 0, 0], 180)
    film = {"type": "hdrfilm", "width": 240, "height": 240, "rfilter": {"type": "box"}}
    plate = move.translate([18, 0, 30]).scale([10, 100, 1])
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "source": pwm.aperture(
            pw.shapes.square(10e-3), frequency=94e9, scene_unit=1e-3, to_world=down,
            estimator=estimator,
        ),
        "floor": {"type": "rectangle", "to_world": move.scale(100)},
        "plate": {"type": "rectangle", "to_world": plate},
        "post": {"type": "cylinder", "p0": [-20, 20, 0], "p1": [-20, 20, 30], "radius": 3},
        "camera": {
            "type": "orthographic",
            # below plate and post, which would hide their shadows
            "to_world": move.look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]).scale([-80, 80, 1]),
            "near_clip": 0.1,
            "film": film,
            "sampler": {"type": "multijitter"},
        },
    }  # fmt: skip


def explorer(folder: Path) -> Path:
    """The explorer's page in Chromium, with the chevron that it starts with."""
    from selenium import webdriver
    from selenium.webdriver.support.wait import WebDriverWait

    command = [sys.executable, "-m", "polywigner", "explore", "--no-browser", "--port", "5067"]
    options = webdriver.ChromeOptions()
    for argument in ("headless=new", "no-sandbox", "window-size=1400,1360"):
        options.add_argument(f"--{argument}")
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        server.stdout.readline()  # the address: the server listens
        service = webdriver.ChromeService(shutil.which("chromedriver"))
        browser = webdriver.Chrome(options, service)
        try:
            browser.get("http://127.0.0.1:5067/")
            ready = (
                "return [...(window.Bokeh?.documents[0]?._all_models.values() ?? [])]"
                ".some((model) => model.text === 'ready')"
            )
            WebDriverWait(browser, 120).until(lambda _: browser.execute_script(ready))
            time.sleep(2)  # the last figure is drawn
            browser.save_screenshot(str(folder / "explorer.png"))
        finally:
            browser.quit()
            server.terminate()
    return folder / "explorer.png"


def by_script(name: str, folder: Path) -> Path:
    script = EXAMPLES / name / f"{name}.py"
    environment = {**os.environ, "MPLBACKEND": "agg"}
    subprocess.run([sys.executable, str(script), str(folder)], env=environment, check=True)
    return folder / f"{name}.png"


def radar_77ghz(folder: Path) -> Path:
    script, out = EXAMPLES / "radar_77ghz" / "radar.py", folder / "radar.png"
    subprocess.run([sys.executable, str(script), "--out", str(out)], check=True)
    return out


def double_edges(folder: Path) -> Path:
    script = ROOT / "benchmarks" / "double_edges.py"
    subprocess.run([sys.executable, str(script), str(folder)], check=True)
    return folder / "double_edges.png"


def near_field(folder: Path) -> Path:
    if not (folder / "boresight.png").exists():
        script = EXAMPLES / "near_field" / "near_field.py"
        subprocess.run([sys.executable, str(script), "--out", str(folder)], check=True)
    return folder


def projections(folder: Path) -> Path:
    chevrons = pw.shapes.chevron_pair(20e-3, 12e-3, 4e-3)
    figure = draw_projections(pw.projections(chevrons, "wigner", samples=257))
    figure.savefig(folder / "projections.png")
    return folder / "projections.png"


def tapers(folder: Path) -> Path:
    """Fields over an aperture, their far fields, and those of an array."""
    wavelength = 299_792_458 / 77e9
    width = 10 * wavelength
    fields = {
        "uniform": pw.uniform(1),
        "cosine, TE10": pw.cosine_taper(width, dimension=1),
        "Taylor, 30 dB": pw.taylor_taper(width, dimension=1),
    }
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    x, sine = np.linspace(-width / 2, width / 2, 401), np.linspace(-1, 1, 4001)
    slit = pw.Slits([-width / 2, width / 2])
    for name, field in fields.items():
        left.plot(x / wavelength, field(x[:, None]).real, label=name)
        lit = slit.with_illumination(field)
        middle.plot(sine, decibels(pw.fourier(lit, sine[:, None] / wavelength)), label=name)
    places = pw.arrays.grid_positions(12, 16, 1.9e-3)
    steered = pw.arrays.steering_weights(places, (0, np.sin(np.radians(20))), wavelength)
    angle = np.linspace(-90, 90, 4001)
    nu = np.stack([0 * angle, np.sin(np.radians(angle)) / wavelength], axis=-1)
    for name in ("uniform", "Taylor"):
        weights = steered * pw.arrays.window_weights((12, 16), name.lower(), sll=25)
        array = pw.phased_array(pw.shapes.rectangle(1.2e-3, 1.0e-3), places, weights)
        right.plot(angle, decibels(pw.fourier(array, nu)), label=f"{name} weights")
    left.set(xlabel="x / wavelength", ylabel="field u", ylim=(0, 1.05))
    middle.set(xlabel="sine of the angle", ylabel="power (dB)", ylim=(-60, 3), xlim=(-1, 1))
    right.set(xlabel="angle (degrees)", ylabel="power (dB)", ylim=(-60, 3), xlim=(-90, 90))
    for axes in (left, middle, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small", loc="lower center" if axes is left else "upper left")
    figure.savefig(folder / "tapers.png", dpi=150)
    return folder / "tapers.png"


def polarised_opening(folder: Path) -> Path:
    """Co- and cross-polar far fields of an opening in a metal screen, and three models of it."""
    opening = pw.shapes.rectangle(1.0, 0.7)  # wavelengths

    def levels(method: str, part: str, theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        found = pw.radiation_pattern(
            opening, 1.0, theta, phi, polarisation="y", method=cast(Any, method)
        )
        power = np.abs(found[part].values) ** 2 * 4 * np.pi / found.attrs["radiated_power"]
        return 10 * np.log10(np.maximum(power, 1e-9))

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(12, 3.9), layout="constrained")
    theta, phi = np.radians(np.arange(0, 91)), np.radians(np.arange(0, 360, 3))
    for axes, part in ((left, "field"), (middle, "cross_field")):
        label = f"directivity (dBi), {floor_text(-25, 'dBi')}"
        draw_disc(axes, theta, phi, levels("magnetic", part, theta, phi), -25.0, 10.0, label)
        axes.set(xlabel=r"$\sin\theta\,\cos\phi$", ylabel=r"$\sin\theta\,\sin\phi$")
    left.set_title("co-polar, magnetic currents, E along y", fontsize=10)
    middle.set_title("cross-polar, the same", fontsize=10)
    angle = np.radians(np.arange(-90, 90.5, 0.5))
    models = (("magnetic", BLUE), ("huygens", GREEN), ("electric", RED))
    for method, colour in models:
        cut = levels(method, "field", angle, np.array([np.pi / 2]))[:, 0]
        right.plot(np.degrees(angle), cut, color=colour, label=method)
    crossed = levels("magnetic", "cross_field", angle, np.array([np.pi / 4]))[:, 0]
    right.plot(np.degrees(angle), crossed, "--", color=BLUE, label="magnetic, cross")
    right.set(xlabel="angle from the normal (degrees)", ylabel="directivity (dBi)")
    right.set(xlim=(-90, 90), ylim=(-25, 16))
    right.set_title("E-plane; cross-polar on the diagonal", fontsize=10)
    right.grid(alpha=0.3)
    right.legend(fontsize="x-small", ncols=2, loc="upper center", frameon=False)
    figure.savefig(folder / "polarised_opening.png", dpi=150)
    return folder / "polarised_opening.png"


def tolerance(folder: Path) -> Path:
    """Patterns of an array with errors, as on the page of patterns."""
    wavelength = pw.SPEED_OF_LIGHT / 77e9
    places = pw.arrays.grid_positions(16, 16, wavelength / 2)
    weights = pw.arrays.window_weights((16, 16), "taylor", sll=30)
    weights = weights * pw.arrays.steering_weights(places, (0.5, 0.0), wavelength)
    array = pw.phased_array(pw.shapes.square(0.48 * wavelength), places, weights)
    theta, phi = np.radians(np.arange(-90, 90.25, 0.25)), np.radians([0, 90])
    errors = {"amplitude": 0.5, "phase": np.radians(5), "dead": 0.03}
    found = pw.array_tolerance(array, wavelength, theta, phi, **errors)
    title = "16 x 16 elements: 0.5 dB and 5° rms, 3 % dead"
    draw_tolerance(found, title=title).savefig(folder / "tolerance.png")
    return folder / "tolerance.png"


def virtual_array(folder: Path) -> Path:
    """The elements of a radar with three transmitters and eight receivers, and its patterns."""
    wavelength = pw.SPEED_OF_LIGHT / 77e9
    patch = pw.shapes.rectangle(0.48 * wavelength, 2 * wavelength)
    sent = pw.arrays.grid_positions(3, 1, 4 * wavelength)
    received = pw.arrays.grid_positions(8, 1, wavelength / 2)
    rows = {
        "virtual": (pw.arrays.virtual_array(sent, received)[0], GREEN, "two_way"),
        "receive": (received, RED, "receive"),
        "transmit": (sent, BLUE, "transmit"),
    }
    pair = pw.phased_array(patch, sent), pw.phased_array(patch, received)
    theta = np.radians(np.arange(-90, 90.1, 0.1))
    found = pw.two_way_pattern(*pair, wavelength, theta, 0.0)
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.6), layout="constrained")
    for row, (name, (places, colour, part)) in enumerate(rows.items()):
        left.plot(places[:, 0] / wavelength, np.full(len(places), row), "s", color=colour, ms=5)
        level = found[part].values[:, 0]
        style = {"lw": 1.6 if part == "two_way" else 0.9, "zorder": 3 - row}
        label = name if part != "two_way" else "two-way, of the virtual array"
        right.plot(np.degrees(theta), level - level.max(), color=colour, label=label, **style)
    left.set(xlabel="x / wavelength", ylim=(-0.6, 2.6))
    left.set_yticks(range(3), list(rows))
    right.set(xlabel="angle from the normal (degrees)", ylabel="level relative to the peak (dB)")
    right.set(xlim=(-90, 90), ylim=(-50, 14))
    right.legend(fontsize="small", loc="upper left", frameon=False)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(folder / "virtual_array.png", dpi=150)
    return folder / "virtual_array.png"


def decibels(amplitudes: np.ndarray) -> np.ndarray:
    power = np.abs(amplitudes) ** 2
    return 10 * np.log10(np.maximum(power / power.max(), 1e-12))


def reduce(source: Path, target: Path, largest: int) -> None:
    with Image.open(source) as picture:
        colours = picture.convert("RGB")
    for width in range(min(WIDEST, colours.width), 0, -50):
        height = round(colours.height * width / colours.width)
        small = colours.resize((width, height), Image.Resampling.LANCZOS)
        # Six bits of each channel look like eight and compress better.
        small.point(lambda value: value & 0xFC | value >> 6).save(target, optimize=True)
        if target.stat().st_size <= largest * 1024:
            break
    print(f"{target} ({target.stat().st_size / 1024:.0f} KiB)")


def small(source: Path, target: Path) -> None:
    """A copy that is shown beside others, of 256 colours.

    Chosen to cover the colours that are there, gradients need no dither, which would be seen as a
    pattern of dots and makes files larger.
    """
    with Image.open(source) as picture:
        colours = picture.convert("RGB")
    height = round(colours.height * README_WIDTH / colours.width)
    copy = colours.resize((README_WIDTH, height), Image.Resampling.LANCZOS)
    few = copy.quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)
    few.save(target, optimize=True)
    print(f"{target} ({target.stat().st_size / 1024:.0f} KiB)")


MAKERS = {
    make.__name__: make
    for make in (
        first_picture, projections, tapers, polarised_opening, tolerance, virtual_array, estimators,
        ranges, radar_77ghz, double_edges, explorer,
    )
}  # fmt: skip
"""Functions of images that no command or example draws by itself."""

if __name__ == "__main__":
    main(sys.argv[1:])
