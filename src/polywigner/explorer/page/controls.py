"""The widgets, each with the name by which tests find it and a label that screen readers say."""

from __future__ import annotations

from collections.abc import Collection, Sequence
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
    InlineStyleSheet,
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
from bokeh.models.widgets.widget import Widget

from polywigner.errors import PolywignerError
from polywigner.explorer.outlines import rows_of_rings
from polywigner.explorer.page import browser
from polywigner.explorer.page.figures import figures_of
from polywigner.explorer.snippets import SNIPPETS, snippet
from polywigner.explorer.state import CATALOGUE, UNITS, History, State, to_query
from polywigner.explorer.views import in_unit

VIEWS = {
    "fourier": "F(ν)", "wigner_nu": "W over ν", "wigner_x": "W over x", "otf": "OTF, defocus",
    "far": "far field", "near": "near field",
}  # fmt: skip
"""Views that can be hidden, and are then not computed."""
STARTS_WITH = ("fourier", "wigner_nu", "wigner_x", "otf", "far")
PARTS = ("level", "real", "phase")
ORDERS = (1, 3)
TYPED = ("unit", "wave", "taper", "array", "window", "steering", "polarisation")
"""Fields of the state whose edits are steps of undo."""
MOVED = ("snap", "reach", "coherence", "defocus", "distance")
"""Numbers of the state whose edits are none."""

_TAKE = [(name, VIEWS[name]) for name in SNIPPETS]
_FILES = {"png": "PNG", "svg": "SVG", "npz": ".npz", "py": "Python"}
_TEXTS = {
    "wave": ("Frequency or λ", ""),
    "steering": ("Steering θ, φ", "20 deg, 90 deg"),
    "taper": ("Taper", "taylor 30 dB"),
    "array": ("Array", "4 x 4, 12 mm"),
    "window": ("Window of the array", "taylor 25 dB"),
    "polarisation": ("Polarisation (far field)", "x, 45 deg, right"),
}
_WIDE: dict[str, Any] = {"sizing_mode": "stretch_width", "margin": (2, 4, 3, 4)}
_HEAD: dict[str, Any] = {"sizing_mode": "fixed", "height": 30, "margin": (0, 3, 0, 3)}
_TABLE_HEIGHT = 150  # pixels


def _row(*widgets: Any) -> Any:
    return row(*widgets, sizing_mode="stretch_width")


def _number(name: str, title: str, **limits: float) -> Any:
    return NumericInput(title=title, mode="float", name=name, **limits, **_WIDE)


def _slider(name: str, title: str, start: float, end: float, step: float) -> Any:
    return Slider(
        title=title, start=start, end=end, step=step, value=max(start, 0), name=name, **_WIDE
    )


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
        self.snap = _number("snap", "Snap to", low=0)
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
        self.texts = {
            name: TextInput(title=title, placeholder=hint, name=name, **_WIDE)
            for name, (title, hint) in _TEXTS.items()
        }
        self.reach = _number("reach", "Largest sin θ (0: auto)", low=0, high=1)
        self.x, self.y = _number("x", "x"), _number("y", "y")
        self.nu_x, self.nu_y = _number("nu_x", "ν_x"), _number("nu_y", "ν_y")
        self.whole = Button(label="Undo zoom", name="whole", width=86, **_HEAD)
        self.part = RadioButtonGroup(labels=["dB", "real part", "phase"], name="part", **_WIDE)
        self.coherence = _slider("coherence", "Coherent over", 0, 20, 0.25)
        self.defocus = _slider("defocus", "Defocus W20 (waves)", -4, 4, 0.05)
        self.distance = _slider("distance", "Near field at z", 1, 200, 1)
        self.order = RadioButtonGroup(labels=["leading order", "third order"], name="order",
                                      **_WIDE)  # fmt: skip
        self.views = CheckboxGroup(labels=list(VIEWS.values()), name="views", inline=True, **_WIDE)
        self.views.active = [list(VIEWS).index(name) for name in STARTS_WITH]
        self.take = Select(title="Take away", options=_TAKE, value="wigner_nu", name="take",
                           **_WIDE)  # fmt: skip
        self.files = {
            kind: Button(label=label, name=f"take_{kind}", **_WIDE)
            for kind, label in _FILES.items()
        }
        self.outlines = {
            "geojson": Button(label="Aperture: GeoJSON", name="take_geojson", **_WIDE),
            "svg": Button(label="Aperture: SVG", name="take_outline_svg", **_WIDE),
        }
        self.code = TextAreaInput(title="Python that computes this view", name="code", rows=9,
                                  cols=40, **_WIDE, max_length=None)  # fmt: skip
        # of one height: a message must not move the figures under the pointer
        self.message = Div(
            text="", name="message", height=36, sizing_mode="stretch_width", margin=(0, 6, 0, 6),
            styles={"overflow-y": "auto"}, stylesheets=[browser.MESSAGE],
        )  # fmt: skip
        self.note = Div(text="", name="note", **_WIDE)
        self.busy = Div(text="", name="busy", height=36, width=250, margin=(0, 6, 0, 6),
                        stylesheets=[browser.BUSY])  # fmt: skip
        self.stale = ColumnDataSource({"figure": []}, name="stale")
        """Figures that are pale, as they are of an older state."""
        self.values = Div(text="", name="values", **_WIDE)
        self.link = TextInput(value="", name="link", visible=False)
        self.tour_text = Div(name="tour", visible=False, styles={"flex": "1 0 100%"},
                             margin=(2, 10, 2, 10))  # fmt: skip
        self.tour = Button(label="What am I looking at?", name="tour_next", width=150, **_HEAD)
        self.tour_back = Button(label="Back", name="tour_back", visible=False, width=58, **_HEAD)
        self.drawer = Toggle(label="Controls", active=True, name="drawer", width=76, **_HEAD)
        text = self.texts
        self.groups = [
            Group(
                "outline", "Outline", 213, self.shape, self.upload, _row(self.unit, self.snap),
                _row(self.draw, self.finish), _row(self.insert, self.delete),
            ),
            Group("light", "Light", 207, _row(text["wave"], text["steering"]),
                  _row(text["taper"], text["array"]), _row(text["window"], self.reach),
                  text["polarisation"]),
            Group("views", "Views", 262, self.views, self.part, self.coherence, self.defocus,
                  self.distance, self.order, self.note),
            Group("vertices", "Vertices", 165, self.table),
            Group("take", "Take away", 266, self.take, _row(*self.files.values()),
                  _row(*self.outlines.values()), self.code),
        ]  # fmt: skip

    def field(self, name: str) -> Any:
        """The widget of a field of the state."""
        return self.texts.get(name) or getattr(self, name)

    def arranged(self, figures: Sequence[Any]) -> Any:
        """The page: a line of messages above controls and figures."""
        head = row(
            self.drawer, self.undo, self.redo, self.whole, self.busy, self.message,
            self.tour_back, self.tour, self.tour_text, name="head", stylesheets=[browser.HEAD],
        )  # fmt: skip
        groups = [part for group in self.groups for part in (group.heading, group.body)]
        side = column(*groups, self.link, stylesheets=[browser.SIDE])
        point = column(
            Div(text="<b>Chosen point</b>", **_WIDE), _row(self.x, self.y),
            _row(self.nu_x, self.nu_y), self.values, name="point", stylesheets=[browser.POINT],
        )  # fmt: skip
        grid = row(*figures, point, stylesheets=[browser.GRID], name="figures")
        main = column(grid, stylesheets=[browser.MAIN], name="main")
        page = column(head, side, main, stylesheets=[browser.PAGE], name="page")
        style = InlineStyleSheet(css=browser.WIDGETS)
        for widget in page.select({"type": Widget}):
            widget.stylesheets = [*widget.stylesheets, style]
        return page

    def fill(self, history: History) -> None:
        """The widgets as the state has them."""
        state = history.present
        for name in TYPED:
            self.field(name).value = getattr(state, name)
        self.snap.value, self.reach.value = state.snap, state.reach
        self.x.value, self.y.value = state.x
        self.nu_x.value, self.nu_y.value = state.nu
        self.x.title, self.y.title = (f"{name} ({state.unit})" for name in "xy")
        self.nu_x.title, self.nu_y.title = (f"{n} (1/{state.unit})" for n in ("ν_x", "ν_y"))
        self.part.active, self.order.active = PARTS.index(state.part), ORDERS.index(state.order)
        for name in ("coherence", "defocus", "distance"):
            slider, at = getattr(self, name), getattr(state, name)
            slider.update(start=min(slider.start, at), end=max(slider.end, at), value=at)
        self.coherence.title = f"Coherent over ({state.unit}; 0: all; of W)"
        self.distance.title = f"Near field at z ({state.unit})"
        self.snap.title = f"Snap to ({state.unit})"
        columns = list(zip(*rows_of_rings(state.rings), strict=True)) or [(), (), ()]
        self.rows.data = dict(zip(("ring", "x", "y"), map(list, columns), strict=True))
        self.undo.disabled, self.redo.disabled = not history.past, not history.future
        self.table.columns[1].title = f"x ({state.unit})"
        self.table.columns[2].title = f"y ({state.unit})"
        self.link.value = to_query(state)

    def show_code(self, state: State) -> None:
        """The snippet of the view that is chosen to be taken away."""
        try:
            self.code.value = snippet(state, self.take.value)
        except PolywignerError as error:
            self.code.value = f"# {error}\n"

    def show_values(self, found: dict[str, tuple[complex, str]], state: State) -> None:
        """Values at the chosen point with twelve digits, to compare with another computation."""
        rows = ""
        for name, (value, quantity) in found.items():
            factor, unit = in_unit(quantity, state.unit)
            number = value * factor
            text = f"{number.real:.12g}"
            if number.imag != 0:
                text += f" {'+' if number.imag >= 0 else '−'} {abs(number.imag):.12g} i"
            rows += f"<tr><td>{name}</td><td>{text} {unit}</td></tr>"
        self.values.text = f'<table aria-live="polite">{rows}</table>'

    def clear(self, view: str) -> None:
        """Empty the text of a view that cannot be computed for this source."""
        said = {"values": self.values, "near": self.note}.get(view)
        if said is not None:
            said.text = ""

    def say_computing(
        self,
        request: int,
        asked: Sequence[str],
        todo: Sequence[tuple[str, int]],
        stale: Collection[str],
    ) -> None:
        """Show which of the requested views are being computed: the first to do, and samples.

        Nothing has come yet of ``stale`` ones. The page itself counts the seconds of a request.
        """
        pictures = [name for name in asked if name in VIEWS]
        done = len(set(pictures) - {name for name, _ in todo})
        text = "computing …"
        if todo and pictures:
            name, samples = todo[0]
            size = f", {samples} × {samples}" if samples else ""
            what = VIEWS.get(name, "values")
            text = f"computing {what}{size}: {done} of {len(pictures)} pictures done"
        self._status("computing", text, stale, request)

    def say_done(self, shown: Collection[str], is_outdated: bool, is_blank: bool) -> None:
        """Say that nothing more comes, and whether pictures are of the outline on show."""
        if is_blank:
            self._status("outdated", "nothing drawn", ())
        elif is_outdated:
            self._status("outdated", "pictures of an earlier state", [*shown, "lags"])
        else:
            self._status("ready", "ready", ())

    def _status(self, kind: str, text: str, stale: Collection[str], request: int = 0) -> None:
        self.busy.text = (
            f'<span class="{kind}" data-request="{request}"><span role="status">{text}</span> '
            '<span class="elapsed" aria-hidden="true"></span></span>'
        )
        figures = [name for view in stale for name in figures_of(view)]
        if self.stale.data["figure"] != figures:
            self.stale.data = {"figure": figures}
