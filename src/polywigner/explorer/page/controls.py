"""The widgets, each with the name by which tests find it and a label that screen readers say."""

from __future__ import annotations

from typing import Any

from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    CellEditor,
    CheckboxGroup,
    ColumnDataSource,
    DataTable,
    Div,
    FileInput,
    NumberEditor,
    NumericInput,
    RadioButtonGroup,
    Select,
    Slider,
    TableColumn,
    TextAreaInput,
    TextInput,
    Toggle,
)

from polywigner.explorer.choices import CATALOGUE, UNITS
from polywigner.explorer.snippets import SNIPPETS

__all__ = ["VIEWS", "Controls"]

VIEWS = {
    "fourier": "F(ν)", "wigner_nu": "W over ν", "wigner_x": "W over x", "otf": "OTF, defocus",
    "far": "far field", "near": "near field",
}  # fmt: skip
"""Views that can be hidden, and are then not computed."""
STARTS_WITH = ("fourier", "wigner_nu", "wigner_x", "otf", "far")

_WIDTH = 300
_TAKE = {name: VIEWS[name] for name in SNIPPETS}
_FILES = {"png": "PNG", "svg": "SVG", "npz": ".npz", "py": "Python"}


def _heading(text: str) -> Div:
    return Div(text=f"<b>{text}</b>", width=_WIDTH, margin=(8, 5, 0, 5))


class Controls:
    """All widgets of one visitor; what they do is the session's business."""

    def __init__(self) -> None:
        half = _WIDTH // 2 - 10
        shapes = [(name, name) for name in (*CATALOGUE, "blank sheet")]
        self.shape = Select(title="Start from", options=[("", "choose a shape …"), *shapes],
                            value="", name="shape", width=_WIDTH)  # fmt: skip
        self.unit = Select(title="Length unit", options=list(UNITS), name="unit", width=half)
        self.upload = FileInput(
            accept=".geojson,.json,.wkt,.csv,.svg,.dxf,.txt", name="upload", width=_WIDTH,
            title="or a file (GeoJSON, WKT, CSV, SVG, DXF; 1 MiB)",
        )  # fmt: skip
        self.draw = Toggle(label="Draw an outline", name="draw", width=half)
        self.finish = Button(label="Finish outline", name="finish", width=half, disabled=True)
        self.undo = Button(label="Undo", name="undo", width=half)
        self.redo = Button(label="Redo", name="redo", width=half)
        self.delete = Button(label="Delete vertex", name="delete", width=half)
        self.insert = Button(label="Insert vertex", name="insert", width=half)
        self.snap = NumericInput(title="Snap to", mode="float", low=0, name="snap", width=half)
        self.rows = ColumnDataSource({"ring": [], "x": [], "y": []}, name="rows")
        self.table = DataTable(
            source=self.rows, editable=True, width=_WIDTH, height=170, name="table",
            index_position=None, autosize_mode="fit_columns", sortable=False, reorderable=False,
            columns=[
                TableColumn(field="ring", title="outline", editor=CellEditor(), width=60),
                TableColumn(field="x", title="x", editor=NumberEditor(), width=115),
                TableColumn(field="y", title="y", editor=NumberEditor(), width=115),
            ],
        )  # fmt: skip
        self.wave = TextInput(title="Frequency or wavelength", name="wave", width=half)
        self.taper = TextInput(title="Taper", placeholder="taylor 30 dB", name="taper",
                               width=half)  # fmt: skip
        self.array = TextInput(title="Array", placeholder="4 x 4, 12 mm", name="array", width=half)
        self.window = TextInput(title="Window of the array", placeholder="taylor 25 dB",
                                name="window", width=half)  # fmt: skip
        self.steering = TextInput(title="Steering θ, φ", placeholder="20 deg, 90 deg",
                                  name="steering", width=half)  # fmt: skip
        self.reach = NumericInput(title="Largest sin θ (0: auto)", mode="float", low=0, high=1,
                                  name="reach", width=half)  # fmt: skip
        self.x, self.y, self.nu_x, self.nu_y = (
            NumericInput(title=title, mode="float", name=name, width=half)
            for title, name in (("x", "x"), ("y", "y"), ("ν_x", "nu_x"), ("ν_y", "nu_y"))
        )
        self.whole = Button(label="Undo zoom", name="whole", width=half)
        self.part = RadioButtonGroup(labels=["dB", "real part", "phase"], name="part",
                                     width=_WIDTH)  # fmt: skip
        self.defocus = Slider(title="Defocus W20 (waves)", start=-4, end=4, step=0.05, value=0,
                              name="defocus", width=_WIDTH)  # fmt: skip
        self.distance = Slider(title="Near field at z", start=1, end=200, step=1, value=50,
                               name="distance", width=_WIDTH)  # fmt: skip
        self.order = RadioButtonGroup(labels=["rays: leading order", "third order"], name="order",
                                      width=_WIDTH)  # fmt: skip
        self.views = CheckboxGroup(labels=list(VIEWS.values()), name="views",
                                   width=_WIDTH)  # fmt: skip
        self.views.active = [list(VIEWS).index(name) for name in STARTS_WITH]
        self.take = Select(title="Take away", options=list(_TAKE.items()), value="wigner_nu",
                           name="take", width=_WIDTH)  # fmt: skip
        quarter = _WIDTH // 4 - 10
        self.files = {
            kind: Button(label=label, name=f"take_{kind}", width=quarter)
            for kind, label in _FILES.items()
        }
        self.outlines = {
            "geojson": Button(label="Aperture: GeoJSON", name="take_geojson", width=half),
            "outline_svg": Button(label="Aperture: SVG", name="take_outline_svg", width=half),
        }
        self.code = TextAreaInput(title="Python that computes this view", name="code", rows=9,
                                  cols=40, width=_WIDTH, max_length=None)  # fmt: skip
        # of one height: a message must not move the figures under the pointer
        self.message = Div(
            text="",
            name="message",
            height=46,
            sizing_mode="stretch_width",
            styles={"overflow-y": "auto"},
        )
        self.note = Div(text="", name="note", width=_WIDTH)
        self.busy = Div(text="", name="busy", width=130)
        self.values = Div(text="", name="values", width=_WIDTH)
        self.link = TextInput(value="", name="link", visible=False)
        self.tour_text = Div(name="tour", width=_WIDTH)
        self.tour = Button(label="What am I looking at?", name="tour_next", width=half + 40)
        self.tour_back = Button(label="Back", name="tour_back", width=60, visible=False)

    def side(self) -> Any:
        """The column at the left."""
        return column(
            row(self.tour_back, self.tour),
            self.tour_text,
            _heading("Aperture"),
            self.shape,
            self.upload,
            row(self.unit, self.snap),
            row(self.draw, self.finish),
            row(self.insert, self.delete),
            row(self.undo, self.redo),
            self.table,
            _heading("Light"),
            row(self.wave, self.steering),
            row(self.taper, self.array),
            row(self.window, self.reach),
            _heading("Chosen point"),
            row(self.x, self.y),
            row(self.nu_x, self.nu_y),
            self.values,
            _heading("Views"),
            self.views,
            self.whole,
            self.part,
            self.defocus,
            self.distance,
            self.order,
            self.note,
            _heading("Take away"),
            self.take,
            row(*self.files.values()),
            row(*self.outlines.values()),
            self.code,
            self.link,
            width=_WIDTH + 20,
        )
