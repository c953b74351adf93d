"""The page: controls, figures and downloads of one browser session, on Panel."""

from __future__ import annotations

import io
import math
import time
import warnings
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from html import escape
from typing import Any, get_args

import panel as pn
from bokeh.models import CustomJSTickFormatter

from polywigner.errors import PolywignerError
from polywigner.explorer import state as states
from polywigner.explorer import views
from polywigner.explorer.plots import Editor, Plot
from polywigner.explorer.state import CATALOGUE, State
from polywigner.explorer.views import VIEWS, Name, Picture

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
_CARD = ":host { background: white; border: 1px solid #d5dbe1; border-radius: 6px; }"
_GROUP = _CARD + ":host { box-shadow: none; }"
_HEAD = ":host { padding: 4px 10px; align-items: center; flex-wrap: wrap; }" + _CARD
_PAIR = ":host { display: grid !important; grid-template-columns: 1fr 1fr; gap: 0 6px; }"

_QUICK_SAMPLES, _FINE_SAMPLES = 48, 64
"""Samples along an axis while the state changes, and the fewest afterwards."""
_SECONDS = 1.0
"""Time of one view, which limits its samples."""

_WIDE: dict[str, Any] = {"sizing_mode": "stretch_width"}
_LOG = {"wavelength": (0.05, 50), "width": (0.5, 100), "distance": (1, 1000)}
"""Ranges of logarithmic sliders, in units."""


class Explorer:
    """One session of the page. ``layout`` is its Panel object, ``history`` its states."""

    def __init__(self, state: State | None = None) -> None:
        self.history = states.History(state or State())
        self._document = pn.state.curdoc
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="explorer")
        self._pictures: dict[Name, tuple[tuple[Any, ...], Picture]] = {}
        self._errors: dict[Name, str] = {}
        self._posted: deque[Callable[[], None]] = deque()
        self._is_following = False  # controls follow the state, so their changes are no edits
        self._editor = Editor(self._outline_edited, lambda point: self.edit(x=point))
        choose_nu = lambda point: self.edit(nu=point)  # noqa: E731
        taps = {"fourier": choose_nu, "wigner_nu": choose_nu, "wigner_x": lambda p: self.edit(x=p)}
        self._plots = {name: Plot(name, taps.get(name)) for name in VIEWS}
        self._controls: dict[str, Any] = {}
        self.layout = self._new_layout()
        if self._document is not None:
            close = partial(self._pool.shutdown, wait=False, cancel_futures=True)
            self._document.on_session_destroyed(lambda _: close())
        self._follow()

    @property
    def state(self) -> State:
        """The present state."""
        return self.history.present

    # --- Changes of the state

    def edit(self, gesture: str = "", **changes: Any) -> None:
        """Change the state; changes of one gesture are one step of the history."""
        try:
            self._change(self.history.then(replace(self.state, **changes), gesture))
        except PolywignerError as error:
            self._say(str(error))
            self._follow()

    def _change(self, history: states.History) -> None:
        if history.present != self.state:
            self._errors.clear()
        self.history = history
        self._follow(is_dragging=history.gesture == "drag")

    def _outline_edited(self, rings: states.Rings, is_final: bool) -> None:
        self.edit("drag", rings=rings)
        if is_final:
            self._change(self.history.ended())

    def _control_changed(self, name: str, event: Any) -> None:
        if self._is_following:
            return
        value = event.new
        if name in _LOG:
            value = float(f"{10**value:.4g}")
        if name == "width":
            self._change(self.history.then(self.state.with_width(value), name))
        elif name == "wavelength":
            self.edit(name, wave=f"{value:g} {self.state.unit}")
        else:
            self.edit(name, **{name: value})

    def _gesture_ended(self, _event: Any) -> None:
        self.history = self.history.ended()

    def _shape_chosen(self, event: Any) -> None:
        if event.new == "blank sheet":
            self.edit(rings=())
            self._draw_toggle.value = True
        elif event.new in CATALOGUE:
            self.edit(rings=states.rings_of(CATALOGUE[event.new]()), x=(0.0, 0.0))
        self._shapes.value = "choose a shape …"

    def _file_chosen(self, event: Any) -> None:
        if not event.new:
            return
        try:
            self.edit(rings=states.read_upload(self._file.filename, event.new, self.state.unit))
        except PolywignerError as error:
            self._say(str(error))

    def _draw_toggled(self, event: Any) -> None:
        self._draw_toggle.label = "Finish outline" if event.new else "Draw outline"
        if event.new:
            self._editor.start_sketch()
            self._say("Click the corners; click the first one again to close the outline.", "info")
        elif self._editor.sketch is not None:
            self._editor.finish_sketch()

    # --- The page follows the state

    def _follow(self, is_dragging: bool = False) -> None:
        """Show the state in the editor and the controls, and compute its views."""
        state = self.state
        self._editor.show(state, keep_handles=is_dragging)
        self._is_following = True
        try:
            for name, control in self._controls.items():
                self._set(name, control)
            if self._draw_toggle.value and self._editor.sketch is None:
                self._draw_toggle.value = False
            self._undo.disabled = not self.history.past
            self._redo.disabled = not self.history.future
        finally:
            self._is_following = False
        self._plots["wigner_x"].show_mark(state.x)
        for plot in (self._plots["fourier"], self._plots["wigner_nu"]):
            plot.show_mark(state.nu)
            plot.show_horizon(1 / (state.wavelength * state.per_metre))
        self._status.object = "computing …"
        self._pool.submit(self._compute, state)

    def _set(self, name: str, control: Any) -> None:
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
                label=f"{control.tags[0]} ({state.unit})" if control.tags[1] else control.tags[0],
            )  # fmt: skip
        elif control.value != value:
            control.value = value

    # --- Computation, in the session's thread

    def _compute(self, state: State) -> None:
        """Compute all visible views: first quickly with few samples, then with more.

        A newer state stops the second part only, so views follow a drag that lasts.
        """
        if state is not self.state:
            return
        try:
            support = views.support_of(state)
        except PolywignerError as error:
            self._post(self._show_invalid, state, str(error))
            return
        self._post(self._show_source, state, support)
        names = [name for name in VIEWS if name in self._visible.value]
        for name in names:
            if not self._is_shown(state, name):
                self._compute_view(state, name, _QUICK_SAMPLES)
        for name in names:
            samples = float(_FINE_SAMPLES)
            while state is self.state and self._is_coarser(name, samples):
                seconds = self._compute_view(state, name, int(samples))
                samples *= max(1.0, math.sqrt(_SECONDS / seconds))
        self._post(self._finish, state)

    def _is_shown(self, state: State, name: Name) -> bool:
        needs, _ = self._pictures.get(name, ((), None))
        return name in self._errors or needs == views.needed(state, name)

    def _is_coarser(self, name: Name, samples: float) -> bool:
        if name in self._errors:
            return False
        _, picture = self._pictures[name]
        return picture.image is not None and len(picture.x) < min(int(samples), views.SAMPLES)

    def _compute_view(self, state: State, name: Name, samples: int) -> float:
        """Compute a view and return the seconds that it took."""
        start = time.perf_counter()
        samples = min(samples, views.SAMPLES)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                picture = views.picture(state, name, samples)
        except PolywignerError as error:
            self._errors[name] = str(error)
            self._post(self._plots[name].show_error, "not available, see above")
            return math.inf
        self._pictures[name] = (views.needed(state, name), picture)
        self._post(self._plots[name].show, picture)
        return time.perf_counter() - start

    def _post(self, show: Callable[..., None], *arguments: Any) -> None:
        """Call a function with the document's lock, after all that were posted before."""
        self._posted.append(partial(show, *arguments))
        if self._document is None:
            self._show_posted()
        else:
            self._document.add_next_tick_callback(self._show_posted)

    def _show_posted(self) -> None:
        # Bokeh may call its callbacks in another order
        while self._posted:
            self._posted.popleft()()

    def _show_source(self, state: State, support: list[views.Polygon]) -> None:
        self._editor.show_support(support)
        self._views.styles = {"grid-area": "views"}
        if state is self.state and not self._errors:
            self._say("")

    def _show_invalid(self, state: State, error: str) -> None:
        if state is self.state:
            self._views.styles = {"grid-area": "views", "opacity": "0.35"}
            self._status.object = "not computed"
            self._say(f"{error} The figures show an earlier outline.")

    def _finish(self, state: State) -> None:
        if state is not self.state:
            return
        self._status.object = "ready"
        self._say("; ".join(f"{VIEWS[n]}: {text}" for n, text in self._errors.items()))
        self._show_code()

    def _say(self, text: str, kind: str = "warning") -> None:
        self._message.param.update(object=text, alert_type=kind, visible=bool(text))

    # --- Downloads

    def _picture(self) -> Picture:
        """Return the picture of the view that is chosen for the downloads."""
        name = self._saved.value
        if name not in self._pictures:
            self._compute_view(self.state, name, views.SAMPLES)
        return self._pictures[name][1]

    def _show_code(self, *_: Any) -> None:
        try:
            code = views.snippet(self.state, self._saved.value, len(self._picture().x))
        except (PolywignerError, KeyError):
            code = ""
        self._code.object = f"<pre>{escape(code)}</pre>"
        self._npz.filename = f"{self._saved.value}.npz"

    # --- Layout

    def _control(self, name: str, control: Any) -> Any:
        control.param.update(sizing_mode="stretch_width", margin=(4, 8))
        control.param.watch(partial(self._control_changed, name), "value")
        if isinstance(control, pn.widgets.FloatSlider):
            control.param.watch(self._gesture_ended, "value_throttled")
        self._controls[name] = control
        return control

    def _slider(self, name: str, label: str, low: float, high: float, step: float) -> Any:
        return self._control(name, pn.widgets.FloatSlider(
            label=label, start=low, end=high, step=step, value=low, tags=[label, False]
        ))  # fmt: skip

    def _log_slider(self, name: str, label: str) -> Any:
        low, high = map(math.log10, _LOG[name])
        shown = CustomJSTickFormatter(code="return (10**tick).toPrecision(3)")
        return self._control(name, pn.widgets.FloatSlider(
            label=label, start=low, end=high, step=0.005, value=low, format=shown,
            tags=[label, True],
        ))  # fmt: skip

    def _select(self, name: str, label: str, options: Any) -> Any:
        return self._control(name, pn.widgets.Select(label=label, options=list(options)))

    def _download(self, content: Callable[[], bytes], label: str) -> Any:
        return pn.widgets.FileDownload(
            label=label, callback=lambda: io.BytesIO(content()), filename="view", margin=(4, 8),
            **_WIDE,
        )  # fmt: skip

    def _new_layout(self) -> Any:
        self._undo = pn.widgets.Button(label="Undo", margin=4, width=70)
        self._redo = pn.widgets.Button(label="Redo", margin=4, width=70)
        self._undo.on_click(lambda _: self._change(self.history.undone()))
        self._redo.on_click(lambda _: self._change(self.history.redone()))
        self._status = pn.pane.HTML("computing …", width=90)
        self._message = pn.pane.Alert("", visible=False, margin=0)
        title = pn.pane.HTML(f"<b>{TITLE}</b>")
        head = pn.Row(
            title, self._undo, self._redo, self._status, self._message,
            stylesheets=[_HEAD], styles={"grid-area": "head"}, **_WIDE,
        )  # fmt: skip
        editor = pn.Column(
            pn.pane.Bokeh(self._editor.plot, sizing_mode="scale_width"),
            self._new_outline_buttons(), stylesheets=[_CARD], styles={"grid-area": "editor"},
            **_WIDE,
        )  # fmt: skip
        panes = {
            name: pn.Column(
                pn.pane.Bokeh(plot.plot, sizing_mode="scale_width"), stylesheets=[_CARD]
            )
            for name, plot in self._plots.items()
        }
        controls = self._new_controls(panes)
        self._views = pn.Column(
            *panes.values(), stylesheets=[_VIEWS], styles={"grid-area": "views"}, **_WIDE
        )
        return pn.Column(
            head, editor, self._views, controls, stylesheets=[_GRID], name="page", **_WIDE
        )

    def _new_outline_buttons(self) -> Any:
        self._draw_toggle = pn.widgets.Toggle(label="Draw outline", margin=(4, 8), **_WIDE)
        self._draw_toggle.param.watch(self._draw_toggled, "value")
        delete = pn.widgets.Button(label="Delete vertex", margin=(4, 8), **_WIDE)
        delete.on_click(lambda _: self._editor.delete_selected())
        shapes = ["choose a shape …", "blank sheet", *CATALOGUE]
        self._shapes = pn.widgets.Select(label="Start from", options=shapes, margin=(4, 8), **_WIDE)
        self._shapes.param.watch(self._shape_chosen, "value")
        self._file = pn.widgets.FileInput(margin=(4, 8), **_WIDE)
        self._file.param.watch(self._file_chosen, "value")
        unit = self._select("unit", "Unit of length", states.UNITS)
        pairs = pn.Column(
            self._draw_toggle, delete, self._shapes, unit, stylesheets=[_PAIR], **_WIDE
        )
        return pn.Column(pairs, self._file, **_WIDE)

    def _new_controls(self, panes: dict[Name, Any]) -> Any:
        integer = partial(pn.widgets.IntInput, start=1, end=states.MAX_ELEMENTS)
        source = [
            self._log_slider("width", "Width"),
            self._log_slider("wavelength", "Wavelength"),
            self._control("wave", pn.widgets.TextInput(label="Frequency or wavelength")),
            self._select("taper", "Taper", get_args(states.Taper)),
            self._slider("theta", "Steering θ (degrees)", 0, 80, 0.5),
            self._slider("phi", "Azimuth φ (degrees)", -180, 180, 1),
        ]
        array = [
            self._control("columns", integer(label="Columns")),
            self._control("rows", integer(label="Rows")),
            self._control("pitch", pn.widgets.FloatInput(label="Pitch", start=1e-6)),
        ]
        shown = [
            self._select("part", "F(ν) as", get_args(states.Part)),
            self._slider("reach", "Largest sin θ (0: auto)", 0, 1, 0.01),
            self._slider("coherence", "Coherent over (0: all)", 0, 30, 0.5),
            self._slider("defocus", "Defocus W20 (waves)", -3, 3, 0.05),
            self._log_slider("distance", "Near field at z"),
        ]
        labels = {label: name for name, label in VIEWS.items()}
        self._visible = pn.widgets.CheckBoxGroup(
            options=labels, value=list(VIEWS), inline=True, margin=(4, 8), **_WIDE,
            stylesheets=[".bk-input-group { flex-wrap: wrap; }"],
        )  # fmt: skip

        def show_views(event: Any) -> None:
            for name, pane in panes.items():
                pane.visible = name in event.new
            self._follow()

        self._visible.param.watch(show_views, "value")
        self._saved = pn.widgets.Select(label="View", options=labels, margin=(4, 8), **_WIDE)
        self._saved.param.watch(self._show_code, "value")
        self._npz = self._download(lambda: views.npz(self._picture()), "npz of the view")
        outline = self._download(
            lambda: states.geojson(self.state).encode(), "GeoJSON of the aperture"
        )
        outline.filename = "aperture.geojson"
        style = "pre { overflow: auto; font-size: 11px; max-height: 260px; user-select: all; }"
        self._code = pn.pane.HTML("", stylesheets=[style], **_WIDE)
        groups = {
            "Source": [pn.Column(*source, stylesheets=[_PAIR], **_WIDE), pn.Row(*array, **_WIDE)],
            "Views": [pn.Column(*shown, stylesheets=[_PAIR], **_WIDE), self._visible],
            "Save": [self._saved, self._npz, outline, self._code],
        }
        cards = [
            pn.Card(*parts, title=title, collapsed=title == "Save", margin=(0, 0, 8, 0),
                    stylesheets=[_GROUP], **_WIDE)
            for title, parts in groups.items()
        ]  # fmt: skip
        return pn.Column(*cards, styles={"grid-area": "controls"}, **_WIDE)


def new_page(state: State | None = None) -> Any:
    """Return the page of a new session as a Panel template."""
    page = pn.Template(TEMPLATE)
    page.title = TITLE
    page.add_panel("page", Explorer(state).layout)
    return page
