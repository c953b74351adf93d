"""The widgets, each with the name by which tests find it and a label that screen readers say."""

from __future__ import annotations

from typing import Any

from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    CellEditor,
    CheckboxGroup,
    ColumnDataSource,
    CustomJS,
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

from polywigner.explorer.snippets import SNIPPETS
from polywigner.explorer.state import CATALOGUE, UNITS

VIEWS = {
    "fourier": "F(ν)", "wigner_nu": "W over ν", "wigner_x": "W over x", "otf": "OTF, defocus",
    "far": "far field", "near": "near field",
}  # fmt: skip
"""Views that can be hidden, and are then not computed."""
STARTS_WITH = ("fourier", "wigner_nu", "wigner_x", "otf", "far")

_TAKE = {name: VIEWS[name] for name in SNIPPETS}
_FILES = {"png": "PNG", "svg": "SVG", "npz": ".npz", "py": "Python"}
_WIDE: dict[str, Any] = {"sizing_mode": "stretch_width", "margin": (2, 4, 3, 4)}
_HEAD: dict[str, Any] = {"sizing_mode": "fixed", "height": 30, "margin": (0, 3, 0, 3)}
_TABLE_HEIGHT = 150  # pixels


def _row(*widgets: Any) -> Any:
    return row(*widgets, sizing_mode="stretch_width")


class Group:
    """Controls below a heading that opens and closes them."""

    def __init__(self, name: str, title: str, height: int, *widgets: Any) -> None:
        self.height = height  # pixels of what is below: which groups a window has room for
        self.heading = Toggle(
            label=title, active=True, name=f"group_{name}", sizing_mode="stretch_width",
            margin=(0, 0, 0, 0), css_classes=["heading"],
        )  # fmt: skip
        self.body = column(
            *widgets, sizing_mode="stretch_width", margin=(2, 4, 8, 4), name=f"body_{name}"
        )
        show = CustomJS(args={"body": self.body}, code="body.visible = cb_obj.active")
        self.heading.js_on_change("active", show)


class Controls:
    """All widgets of one visitor, without their callbacks."""

    def __init__(self) -> None:
        shapes = [(name, name) for name in (*CATALOGUE, "blank sheet")]
        self.shape = Select(title="Start from", options=[("", "choose a shape …"), *shapes],
                            value="", name="shape", **_WIDE)  # fmt: skip
        self.unit = Select(title="Length unit", options=list(UNITS), name="unit", **_WIDE)
        self.upload = FileInput(
            accept=".geojson,.json,.wkt,.csv,.svg,.dxf,.txt", name="upload", **_WIDE,
            title="or a file (GeoJSON, WKT, CSV, SVG, DXF; 1 MiB)",
        )  # fmt: skip
        self.draw = Toggle(label="Draw an outline", name="draw", **_WIDE)
        self.finish = Button(label="Finish outline", name="finish", **_WIDE, disabled=True)
        self.undo = Button(label="Undo", name="undo", width=58, **_HEAD)
        self.redo = Button(label="Redo", name="redo", width=58, **_HEAD)
        self.delete = Button(label="Delete vertex", name="delete", **_WIDE)
        self.insert = Button(label="Insert vertex", name="insert", **_WIDE)
        self.snap = NumericInput(title="Snap to", mode="float", low=0, name="snap", **_WIDE)
        self.rows = ColumnDataSource({"ring": [], "x": [], "y": []}, name="rows")
        self.table = DataTable(
            source=self.rows, editable=True, **_WIDE, height=_TABLE_HEIGHT, name="table",
            index_position=None, autosize_mode="fit_columns", sortable=False, reorderable=False,
            columns=[
                TableColumn(field="ring", title="outline", editor=CellEditor(), width=60),
                TableColumn(field="x", title="x", editor=NumberEditor(), width=100),
                TableColumn(field="y", title="y", editor=NumberEditor(), width=100),
            ],
        )  # fmt: skip
        self.wave = TextInput(title="Frequency or λ", name="wave", **_WIDE)
        self.taper = TextInput(title="Taper", placeholder="taylor 30 dB", name="taper", **_WIDE)
        self.array = TextInput(title="Array", placeholder="4 x 4, 12 mm", name="array", **_WIDE)
        self.window = TextInput(title="Window of the array", placeholder="taylor 25 dB",
                                name="window", **_WIDE)  # fmt: skip
        self.steering = TextInput(title="Steering θ, φ", placeholder="20 deg, 90 deg",
                                  name="steering", **_WIDE)  # fmt: skip
        self.polarisation = TextInput(title="Polarisation (far field)",
                                      placeholder="x, 45 deg, right", name="polarisation",
                                      **_WIDE)  # fmt: skip
        self.reach = NumericInput(title="Largest sin θ (0: auto)", mode="float", low=0, high=1,
                                  name="reach", **_WIDE)  # fmt: skip
        self.x, self.y, self.nu_x, self.nu_y = (
            NumericInput(title=title, mode="float", name=name, **_WIDE)
            for title, name in (("x", "x"), ("y", "y"), ("ν_x", "nu_x"), ("ν_y", "nu_y"))
        )
        self.whole = Button(label="Undo zoom", name="whole", width=86, **_HEAD)
        self.part = RadioButtonGroup(labels=["dB", "real part", "phase"], name="part", **_WIDE)
        self.coherence = Slider(title="Coherent over", start=0, end=20, step=0.25, value=0,
                                name="coherence", **_WIDE)  # fmt: skip
        self.defocus = Slider(title="Defocus W20 (waves)", start=-4, end=4, step=0.05, value=0,
                              name="defocus", **_WIDE)  # fmt: skip
        self.distance = Slider(title="Near field at z", start=1, end=200, step=1, value=50,
                               name="distance", **_WIDE)  # fmt: skip
        self.order = RadioButtonGroup(labels=["leading order", "third order"], name="order",
                                      **_WIDE)  # fmt: skip
        self.views = CheckboxGroup(labels=list(VIEWS.values()), name="views", inline=True, **_WIDE)
        self.views.active = [list(VIEWS).index(name) for name in STARTS_WITH]
        self.take = Select(title="Take away", options=list(_TAKE.items()), value="wigner_nu",
                           name="take", **_WIDE)  # fmt: skip
        self.files = {
            kind: Button(label=label, name=f"take_{kind}", **_WIDE)
            for kind, label in _FILES.items()
        }
        self.outlines = {
            "geojson": Button(label="Aperture: GeoJSON", name="take_geojson", **_WIDE),
            "outline_svg": Button(label="Aperture: SVG", name="take_outline_svg", **_WIDE),
        }
        self.code = TextAreaInput(title="Python that computes this view", name="code", rows=9,
                                  cols=40, **_WIDE, max_length=None)  # fmt: skip
        # of one height: a message must not move the figures under the pointer
        self.message = Div(text="", name="message", height=36, sizing_mode="stretch_width",
                           margin=(0, 6, 0, 6), styles={"overflow-y": "auto"})  # fmt: skip
        self.note = Div(text="", name="note", **_WIDE)
        self.busy = Div(text="", name="busy", height=36, width=250, margin=(0, 6, 0, 6))
        self.values = Div(text="", name="values", **_WIDE)
        self.link = TextInput(value="", name="link", visible=False)
        self.tour_text = Div(name="tour", visible=False, styles={"flex": "1 0 100%"},
                             margin=(2, 10, 2, 10))  # fmt: skip
        self.tour = Button(label="What am I looking at?", name="tour_next", width=150, **_HEAD)
        self.tour_back = Button(label="Back", name="tour_back", visible=False, width=58, **_HEAD)
        self.drawer = Toggle(label="Controls", active=True, name="drawer", width=76, **_HEAD)
        self.groups = [
            Group(
                "outline", "Outline", 213, self.shape, self.upload, _row(self.unit, self.snap),
                _row(self.draw, self.finish), _row(self.insert, self.delete),
            ),
            Group("light", "Light", 207, _row(self.wave, self.steering),
                  _row(self.taper, self.array), _row(self.window, self.reach),
                  self.polarisation),
            Group("views", "Views", 262, self.views, self.part, self.coherence, self.defocus,
                  self.distance, self.order, self.note),
            Group("vertices", "Vertices", 165, self.table),
            Group("take", "Take away", 266, self.take, _row(*self.files.values()),
                  _row(*self.outlines.values()), self.code),
        ]  # fmt: skip

    def head(self) -> Any:
        """The line above all."""
        return row(
            self.drawer, self.undo, self.redo, self.whole, self.busy, self.message,
            self.tour_back, self.tour, self.tour_text, name="head",
        )  # fmt: skip

    def side(self) -> Any:
        """The column at the left."""
        groups = [part for group in self.groups for part in (group.heading, group.body)]
        return column(*groups, self.link)

    def point(self) -> Any:
        """The chosen point and the values there, among the figures."""
        title = Div(text="<b>Chosen point</b>", **_WIDE)
        return column(
            title, _row(self.x, self.y), _row(self.nu_x, self.nu_y), self.values, name="point"
        )
