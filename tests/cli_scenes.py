"""XML of small scenes for tests of commands."""

from __future__ import annotations

from pathlib import Path

OF_THE_SQUARE = """
    <string name="aperture" value="square.wkt"/>
    <string name="frequency" value="94 GHz"/>"""
WIGNER = '<string name="estimator" value="wigner"/>'
LOOKING_DOWN = '<lookat origin="0, 0, 1" target="0, 0, 0" up="0, 1, 0"/>'
PATH = '<integrator type="path"><integer name="max_depth" value="{0}"/></integrator>'


def scene(*parts: str) -> str:
    return f'<scene version="3.0.0">{"".join(parts)}</scene>'


def source(*more: str) -> str:
    """Return the square as a Wigner source at 94 GHz, with further parameters."""
    return f'<shape type="wigner" id="tx">{OF_THE_SQUARE}{"".join(more)}</shape>'


def receiver(*more: str, pose: str = LOOKING_DOWN, name: str = "rx", pixels: int = 1) -> str:
    """Return the square as a receiver, with further parameters."""
    return f"""<sensor type="wigner_receiver" id="{name}">{OF_THE_SQUARE}{"".join(more)}
    <transform name="to_world">{pose}</transform>
    <film type="hdrfilm">
        <integer name="width" value="{pixels}"/><integer name="height" value="{pixels}"/>
        <rfilter type="box"/>
    </film>
</sensor>"""


def camera(half: float, look: str, size: tuple[int, int], samples: int | str = 16) -> str:
    """Return an orthographic camera with one channel over 2 x ``half`` scene units."""
    return f"""<sensor type="orthographic">
    <transform name="to_world"><scale x="{half}" y="{half}"/>{look}</transform>
    <sampler type="independent"><integer name="sample_count" value="{samples}"/></sampler>
    <film type="hdrfilm">
        <integer name="width" value="{size[0]}"/><integer name="height" value="{size[1]}"/>
        <string name="pixel_format" value="luminance"/><rfilter type="box"/>
    </film>
</sensor>"""


def rectangle(pose: str, more: str = "", name: str = "floor") -> str:
    return f"""<shape type="rectangle" id="{name}">
    <transform name="to_world">{pose}</transform>{more}
</shape>"""


def written(folder: Path, text: str, half: float = 5) -> Path:
    """Write a scene, and its square of 2 x ``half`` mm, to files."""
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
    ring = ", ".join(f"{half * x} {half * y}" for x, y in corners)
    (folder / "square.wkt").write_text(f"POLYGON (({ring}))")
    path = folder / "scene.xml"
    path.write_text(text)
    return path
