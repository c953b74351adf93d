"""Panel page of a browser session: controls, figures and downloads.

``panel serve`` can serve this file.
"""

from __future__ import annotations

import io
import math
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any, get_args

import panel as pn
from bokeh.models import CustomJSTickFormatter

from polywigner.errors import PolywignerError
from polywigner.explorer import state as states
from polywigner.explorer import views
from polywigner.explorer.plots import Editor, Plot
from polywigner.explorer.state import CATALOGUE, State, read_upload
from polywigner.explorer.views import VIEWS, Name, View

if TYPE_CHECKING:
    from bokeh.plotting import figure
    from panel.layout import ListPanel
    from panel.viewable import Viewable
    from panel.widgets import Widget

TITLE = "polywigner explorer"
TEMPLATE = """
{% extends base %}
{% block preamble %}
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>body { background: #eef1f4; font-family: system-ui, sans-serif; }</style>
{% endblock %}
{% block contents %}{{ embed(roots.page) }}{% endblock %}
"""
_GRID = """
:host { display: grid !important; gap: 8px; padding: 8px; box-sizing: border-box; width: 100%;
  grid-template-columns: 390px minmax(0, 1fr); grid-template-rows: auto auto 1fr;
  grid-template-areas: "head head" "editor views" "controls views"; align-items: start; }
@media (max-width: 800px) {
  :host { grid-template-columns: minmax(0, 1fr); padding: 4px; grid-template-rows: none;
    grid-template-areas: "head" "editor" "views" "controls"; } }
"""
_VIEWS = """
:host { display: grid !important; gap: 8px; width: 100%;
  grid-template-columns: repeat(auto-fill, minmax(min(310px, 100%), 1fr)); align-items: start; }
"""
_CARD = """
:host { background: white; border: 1px solid #d5dbe1; border-radius: 6px; box-shadow: none; }
"""
_HEAD = ":host { padding: 4px 10px; align-items: center; flex-wrap: wrap; }" + _CARD
_PAIR = ":host { display: grid !important; grid-template-columns: 1fr 1fr; gap: 0 6px; }"

_QUICK_SAMPLES = 49  # number of samples along an axis during a change
_SECONDS = 1.0  # longest computing time of a view after a change [s]
_WIDE: dict[str, Any] = {"sizing_mode": "stretch_width"}
_FIELD: dict[str, Any] = {"margin": (4, 8), **_WIDE}
# Lower and upper limits of logarithmic sliders.
_LOG = {"wavelength": (0.05, 50), "width": (0.5, 100), "distance": (1, 1000)}


class Explorer:
    """One session of the page.

    Without a Bokeh document, all views have few samples.
    """

    def __init__(self, state: State | None = None) -> None:
        self.history = states.History(state or State())
        self._document: Any = pn.state.curdoc
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="explorer")
        # key, computing time [s] and result of each view
        self._computed_views: dict[Name, tuple[str, float, View]] = {}
        self._errors: dict[Name, str] = {}
        self._scheduled: deque[Callable[[], None]] = deque()
        self._is_following = False  # whether the controls are being set from the state
        self._editor = Editor(self._outline_edited, lambda point: self.edit(x=point))
        choose_nu = lambda point: self.edit(nu=point)  # noqa: E731
        taps = {"fourier": choose_nu, "wigner_nu": choose_nu, "wigner_x": lambda p: self.edit(x=p)}
        self._plots = {name: Plot(name, taps.get(name)) for name in VIEWS}
        self._controls: dict[str, Widget] = {}
        self.layout = self._new_layout()
        self._show_state()

    def page(self) -> pn.Template:
        """Return the template of the current Bokeh document."""
        if self._document is None:
            # Wait for the computing thread. From then on, models change only under the document's
            # lock.
            self._pool.submit(int).result()
            self._document = pn.state.curdoc
            self._pool.submit(self._compute_views, self.state)
        close = partial(self._pool.shutdown, wait=False, cancel_futures=True)
        self._document.on_session_destroyed(lambda _: close())
        page = _Page(TEMPLATE)
        page.title = TITLE
        page.add_panel("page", self.layout)
        return page

    @property
    def state(self) -> State:
        """Current state."""
        return self.history.present

    def edit(self, gesture: str = "", **changes: Any) -> None:
        """Change the state; successive changes of a named gesture form one undo step."""
        self._add_state(lambda: replace(self.state, **changes), gesture)

    def _add_state(self, new_state: Callable[[], State], gesture: str = "") -> None:
        """Add the state that ``new_state()`` returns to the history, and show it.

        If the state is invalid, show an error instead.
        """
        try:
            self.history.add(new_state(), gesture)
        except PolywignerError as error:
            self._show_message(str(error))
            self._show_controls()
        else:
            self._show_state(is_dragging=gesture == "drag")

    def _undo_or_redo(self, steps: int) -> None:
        """Undo (negative) or redo (positive) a number of steps."""
        self.history.move(steps)
        self._show_state()

    def _outline_edited(self, rings: states.Rings, is_final: bool) -> None:
        """Replace the outlines; ``is_final`` is False during a drag."""
        self.edit("drag", rings=rings)
        if is_final:
            self._undo_or_redo(0)

    def _control_changed(self, name: str, event: Any) -> None:
        """Change the state to the new value of a control."""
        if self._is_following:
            return
        value = event.new
        if name in _LOG:
            value = float(f"{10**value:.4g}")
        if name == "width":
            self._add_state(lambda: self.state.with_width(value), name)
        elif name == "wavelength":
            self.edit(name, wave=f"{value:g} {self.state.unit}")
        else:
            self.edit(name, **{name: value})

    def _shape_chosen(self, event: Any) -> None:
        """Replace the outlines with a shape from the catalogue or a blank sheet."""
        if event.new == "blank sheet":
            self.edit(rings=())
            self._draw_toggle.value = True
        elif event.new in CATALOGUE:
            self.edit(rings=states.rings_of(CATALOGUE[event.new]()), x=(0.0, 0.0))
        self._shapes.value = "choose a shape …"

    def _file_chosen(self, event: Any) -> None:
        """Replace the outlines with the outlines in an uploaded file."""
        if event.new:
            file = self._file.filename, event.new, self.state.unit
            self._add_state(lambda: replace(self.state, rings=read_upload(*file)))

    def _draw_toggled(self, event: Any) -> None:
        """Start or finish drawing a new outline."""
        self._draw_toggle.label = "Finish outline" if event.new else "Draw outline"
        if event.new:
            self._editor.start_sketch()
            self._show_message(
                "Click the corners; click the first one again to close the outline.", "info"
            )
        elif self._editor.sketch is not None:
            self._editor.finish_sketch()

    def _show_state(self, is_dragging: bool = False) -> None:
        """Show the current state, and start to compute its views in the thread."""
        state = self.state
        self._errors.clear()
        self._editor.show(state, keep_handles=is_dragging)
        self._show_controls()
        self._plots["wigner_x"].show_mark(state.x)
        for plot in (self._plots["fourier"], self._plots["wigner_nu"]):
            plot.show_mark(state.nu, 1 / (state.wavelength * state.per_metre))
        self._status.object = "computing …"
        self._pool.submit(self._compute_views, state)

    def _show_controls(self) -> None:
        """Set all controls to the values of the current state."""
        self._is_following = True
        try:
            for name, control in self._controls.items():
                self._set_control(name, control)
            if self._draw_toggle.value and self._editor.sketch is None:
                self._draw_toggle.value = False
            self._undo.disabled = not self.history.can_move(-1)
            self._redo.disabled = not self.history.can_move(1)
        finally:
            self._is_following = False

    def _set_control(self, name: str, control: Widget) -> None:
        """Set a control to its value in the current state."""
        state = self.state
        x0, _, x1, _ = state.box
        lengths = {"wavelength": state.wavelength * state.per_metre, "width": x1 - x0}
        value = lengths.get(name, getattr(state, name, None))
        if name in _LOG:
            if not value or value <= 0:
                return
            value = math.log10(value)
        if isinstance(control, pn.widgets.FloatSlider):
            control.param.update(
                start=min(control.start, value), end=max(control.end, value), value=value,
                label=control.tags[0] + (f" ({state.unit})" if name in _LOG else ""),
            )  # fmt: skip
        elif control.value != value:
            control.value = value

    def _compute_views(self, state: State) -> None:
        """Compute all views with few samples, then with more samples.

        A newer state cancels only the second pass, so that the views follow a drag.
        """
        if state is not self.state:
            return
        try:
            support = views.support_of(state)
        except PolywignerError as error:
            self._schedule(self._show_invalid, state, str(error))
            return
        self._schedule(self._show_support, support)
        for name in VIEWS:
            key_shown, *_ = self._computed_views.get(name, ("",))
            if key_shown != _view_key(state, name) and name not in self._errors:
                self._compute_view(state, name, _QUICK_SAMPLES)
        for name in VIEWS if self._document is not None else ():
            if state is not self.state or name in self._errors:
                continue
            _, seconds, view = self._computed_views[name]
            possible = int(view.samples * math.sqrt(_SECONDS / seconds))
            samples = min(views.SAMPLES, possible | 1)
            if 0 < view.samples < samples:
                self._compute_view(state, name, samples)
        self._schedule(self._show_ready, state)

    def _compute_view(self, state: State, name: Name, samples: int) -> None:
        """Compute a view, and schedule its display or the display of an error."""
        start = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                view = views.compute_view(state, name, samples)
        except PolywignerError as error:
            self._errors[name] = str(error)
            self._schedule(self._plots[name].show_error, "not available, see above")
            return
        self._computed_views[name] = _view_key(state, name), time.perf_counter() - start, view
        self._schedule(self._plots[name].show, view)

    def _schedule(self, show: Callable[..., None], *arguments: Any) -> None:
        """Schedule a function call under the document's lock; the order of the calls is kept."""
        self._scheduled.append(partial(show, *arguments))
        if self._document is None:
            self._run_scheduled()
        else:
            self._document.add_next_tick_callback(self._run_scheduled)

    def _run_scheduled(self) -> None:
        """Run all scheduled function calls in their order."""
        # Each call runs all scheduled functions in order, because Bokeh may change the order of its
        # callbacks.
        while self._scheduled:
            self._scheduled.popleft()()

    def _show_support(self, support: list[views.Polygon]) -> None:
        """Draw the region outside which W is zero, and show the views as valid."""
        self._editor.show_support(support)
        self._views.styles = {"grid-area": "views", "opacity": "1"}

    def _show_invalid(self, state: State, error: str) -> None:
        """Report that outlines are invalid, and fade the views, unless ``state`` is outdated."""
        if state is self.state:
            self._views.styles = {"grid-area": "views", "opacity": "0.35"}
            self._status.object = "not computed"
            self._show_message(f"{error} The figures show an earlier outline.")

    def _show_ready(self, state: State) -> None:
        """Show the Python code and the errors of failed views, unless ``state`` is outdated."""
        if state is not self.state:
            return
        self._status.object = "ready"
        self._show_message("; ".join(f"{VIEWS[n]}: {text}" for n, text in self._errors.items()))
        self._show_code()

    def _show_message(self, text: str, kind: str = "warning") -> None:
        """Show a message above the outline editor; an empty text hides it."""
        self._message.param.update(object=text, alert_type=kind, visible=bool(text))

    def _saved_view(self) -> View:
        """Return the view that is selected for saving; compute it if necessary."""
        name = self._saved.value
        if name not in self._computed_views:
            self._compute_view(self.state, name, views.SAMPLES)
        return self._computed_views[name][2]

    def _show_code(self, *_: Any) -> None:
        """Show the Python code of the view that is selected for saving."""
        try:
            code = views.snippet(self.state, self._saved.value, self._saved_view().samples)
        except (PolywignerError, KeyError):
            code = ""
        self._code.object = f"<pre>{escape(code)}</pre>"
        self._npz.filename = f"{self._saved.value}.npz"

    def _connected(self, name: str, control: Widget) -> Widget:
        """Connect a control to the state variable ``name``, and return the control."""
        control.param.update(**_FIELD)
        control.param.watch(partial(self._control_changed, name), "value")
        if isinstance(control, pn.widgets.FloatSlider):
            control.param.watch(lambda _: self.history.move(0), "value_throttled")
        self._controls[name] = control
        return control

    def _slider(self, name: str, label: str, low: float, high: float, step: float) -> Widget:
        """Return a slider for the state variable ``name``."""
        return self._connected(name, pn.widgets.FloatSlider(
            label=label, start=low, end=high, step=step, value=low, tags=[label]
        ))  # fmt: skip

    def _log_slider(self, name: str, label: str) -> Widget:
        """Return a slider for the decimal logarithm of a length in the unit of the page."""
        low, high = map(math.log10, _LOG[name])
        slider = self._slider(name, label, low, high, 0.005)
        slider.format = CustomJSTickFormatter(code="return (10**tick).toPrecision(3)")
        return slider

    def _select(self, name: str, label: str, options: Iterable[str]) -> Widget:
        """Return a drop-down list for the state variable ``name``."""
        return self._connected(name, pn.widgets.Select(label=label, options=list(options)))

    def _new_layout(self) -> ListPanel:
        """Return the layout of the page: head, outline editor, views and controls."""
        self._undo = pn.widgets.Button(label="Undo", margin=4, width=70)
        self._redo = pn.widgets.Button(label="Redo", margin=4, width=70)
        self._undo.on_click(lambda _: self._undo_or_redo(-1))
        self._redo.on_click(lambda _: self._undo_or_redo(1))
        self._status = pn.pane.HTML("computing …", width=90)
        self._message = pn.pane.Alert("", visible=False, margin=0)
        title = pn.pane.HTML(f"<b>{TITLE}</b>")
        parts = title, self._undo, self._redo, self._status, self._message
        head = _box(_HEAD, *parts, area="head", kind=pn.Row)
        outline = _figure_pane(self._editor.plot), self._new_outline_buttons()
        editor = _box(_CARD, *outline, area="editor")
        figures = [_box(_CARD, _figure_pane(plot.plot)) for plot in self._plots.values()]
        self._views = _box(_VIEWS, *figures, area="views")
        return _box(_GRID, head, editor, self._views, self._new_controls())

    def _new_outline_buttons(self) -> ListPanel:
        """Return the controls below the outline editor."""
        self._draw_toggle = pn.widgets.Toggle(label="Draw outline", **_FIELD)
        self._draw_toggle.param.watch(self._draw_toggled, "value")
        delete = pn.widgets.Button(label="Delete vertex", **_FIELD)
        delete.on_click(lambda _: self._editor.delete_selected())
        shapes = ["choose a shape …", "blank sheet", *CATALOGUE]
        self._shapes = pn.widgets.Select(label="Start from", options=shapes, **_FIELD)
        self._shapes.param.watch(self._shape_chosen, "value")
        self._file = pn.widgets.FileInput(**_FIELD)
        self._file.param.watch(self._file_chosen, "value")
        unit = self._select("unit", "Unit of length", states.UNITS)
        return _box("", _box(_PAIR, self._draw_toggle, delete, self._shapes, unit), self._file)

    def _new_controls(self) -> ListPanel:
        """Return the cards with controls for the source, the views and saving."""
        integer = partial(pn.widgets.IntInput, start=1, end=states.MAX_ELEMENTS)
        source = [
            self._log_slider("width", "Width"),
            self._log_slider("wavelength", "Wavelength"),
            self._connected("wave", pn.widgets.TextInput(label="Frequency or wavelength")),
            self._select("taper", "Taper", states.TAPERS),
            self._slider("theta", "Steering θ (degrees)", 0, 80, 0.5),
            self._slider("phi", "Azimuth φ (degrees)", -180, 180, 1),
        ]
        array = [
            self._connected("columns", integer(label="Columns")),
            self._connected("rows", integer(label="Rows")),
            self._connected("pitch", pn.widgets.FloatInput(label="Pitch", start=1e-6)),
        ]
        shown = [
            self._select("part", "F(ν) as", get_args(states.Part)),
            self._slider("reach", "Largest sin θ (0: auto)", 0, 1, 0.01),
            self._slider("defocus", "Defocus W20 (waves)", -3, 3, 0.05),
            self._log_slider("distance", "Near field at z"),
        ]
        labels = {label: name for name, label in VIEWS.items()}
        self._saved = pn.widgets.Select(label="View", options=labels, **_FIELD)
        self._saved.param.watch(self._show_code, "value")
        self._npz = _download("npz of the view", lambda: views.npz(self._saved_view()))
        geojson = lambda: states.geojson(self.state).encode()  # noqa: E731
        outline = _download("GeoJSON of the aperture", geojson, "aperture.geojson")
        style = "pre { overflow: auto; font-size: 11px; max-height: 260px; user-select: all; }"
        self._code = pn.pane.HTML("", stylesheets=[style], **_WIDE)
        groups = {
            "Source": [_box(_PAIR, *source), _box("", *array, kind=pn.Row)],
            "Views": [_box(_PAIR, *shown)],
            "Save": [self._saved, self._npz, outline, self._code],
        }
        cards = [
            pn.Card(*parts, title=title, collapsed=title == "Save", margin=(0, 0, 8, 0),
                    stylesheets=[_CARD], **_WIDE)
            for title, parts in groups.items()
        ]  # fmt: skip
        return _box("", *cards, area="controls")


def _box(css: str, *parts: Viewable, area: str = "auto", kind: Any = pn.Column) -> ListPanel:
    """Return a stretched Panel container with CSS rules, placed in an area of the page grid."""
    return kind(*parts, stylesheets=[css], styles={"grid-area": area}, **_WIDE)


def _download(label: str, content: Callable[[], bytes], filename: str = "view") -> Widget:
    """Return a button that downloads the bytes that ``content`` returns."""
    read = lambda: io.BytesIO(content())  # noqa: E731
    return pn.widgets.FileDownload(label=label, callback=read, filename=filename, **_FIELD)


def _figure_pane(plot: figure) -> Viewable:
    """Return a Panel pane for a Bokeh figure."""
    return pn.pane.Bokeh(plot, sizing_mode="scale_width")


def _view_key(state: State, name: Name) -> str:
    """Return a string that changes when a view must be computed again."""
    return views.snippet(state, name) + (state.part if name == "fourier" else "")


class _Page(pn.Template):
    """Template with a short repr, because Panel writes the repr into the page."""

    def __repr__(self) -> str:
        return TITLE


if __name__.startswith("bokeh_app"):  # "panel serve" runs this file as an application.
    Explorer().page().servable()
