"""Help for visitors without a mouse or a screen: names, roles, and keys that come to Python."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bokeh.events import DocumentReady
from bokeh.models import CustomJS, InlineStyleSheet
from bokeh.models.widgets.widget import Widget

from polywigner.explorer.page import theme

if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session


_RING = "2px solid var(--pw-mark)"
_FOCUS = f"""
.bk-btn:focus-visible, .bk-input:focus-visible, input:focus-visible, .noUi-handle:focus-visible {{
  outline: {_RING} !important; outline-offset: 1px; }}
:host(.bk-DataTable:focus-within) {{ outline: {_RING}; }}
:host .slick-cell.active {{ border: {_RING}; }}
"""

WITH_KEYS = {
    "aperture": "N and P choose a vertex and arrows move it, with Shift ten steps; Insert adds "
    "one after it, Delete takes it away, Escape lets it go: then arrows move the position x. "
    "While an outline is drawn, the space bar puts a corner at the position.",
    "fourier": "Arrows move the spatial frequency, with Shift ten steps.",
    "wigner_nu": "Arrows move the spatial frequency, with Shift ten steps.",
    "wigner_x": "Arrows move the position x, with Shift ten steps.",
}
"""Figures that take keys, with the help text of each; other figures are pictures."""

_ROLES = """
const view_of = (model) => Bokeh.index.find_one(model)
const named = (element, role, label) => {
  if (!element) { return }
  if (role) { element.setAttribute("role", role) }
  element.setAttribute("aria-label", label)
}
for (const slider of sliders) {
  const name = () => named(view_of(slider).shadow_el.querySelector(".noUi-handle"), null,
                           slider.title)
  name()
  slider.properties.title.change.connect(name)
}
for (const [group, label] of groups) {
  const view = view_of(group)
  named(view.shadow_el.firstElementChild, "group", label)
  const press = () => view.shadow_el.querySelectorAll("button").forEach((button, k) => {
    button.setAttribute("aria-pressed", k === group.active)
  })
  press()
  group.properties.active.change.connect(press)
}
for (const [toggle, attribute] of toggles) {
  const press = () => view_of(toggle)?.shadow_el.querySelector("button")
    .setAttribute(attribute, toggle.active)
  press()
  toggle.properties.active.change.connect(press)
}
for (const [text, live, label] of texts) {
  const {el} = view_of(text)
  named(el, live === "assertive" ? "alert" : "status", label)
  el.setAttribute("aria-live", live)
}
for (const figure of figures) {
  const view = view_of(figure), keys = with_keys[figure.name]
  const element = view?.canvas_view?.events_el
  if (!element) { continue }
  element.tabIndex = keys ? 0 : -1
  element.addEventListener("focus", () => {
    if (element.matches(":focus-visible")) { element.style.outline = ring }
  })
  element.addEventListener("blur", () => { element.style.outline = "none" })
  const name = () => named(element, keys ? "application" : "img",
                           figure.title.text + (keys ? ". " + keys : ""))
  name()
  figure.title.properties.text.change.connect(name)
}
named(view_of(side)?.el, "form", "What is drawn, lit and shown")
named(view_of(main)?.el, "main", "Figures")
document.documentElement.lang = "en"
"""

# SlickGrid keeps the tabulator for its cells, and lets nobody out. Cells are left to the arrows:
# one stop before them, where the first cell becomes the current one.
_TABLE = """
const view = Bokeh.index.find_one(table), {shadow_el} = view
const stops = [...shadow_el.querySelectorAll("[tabindex='0']")]
const first = stops[0], last = stops.at(-1)
for (const stop of stops) { if (stop !== first) { stop.tabIndex = -1 } }
for (const stop of [first, last]) {  // the last is where the grid puts the focus itself
  stop.setAttribute("role", "application")
  stop.setAttribute("aria-label", "Vertices: arrows go from cell to cell, Enter edits one")
}
const arrived = () => {
  if (!view.grid.getActiveCell() && view.grid.getDataLength() > 0) { view.grid.setActiveCell(0, 1) }
}
first.addEventListener("focus", arrived)
shadow_el.addEventListener("keydown", (event) => {
  if (event.key !== "Tab" || event.composedPath()[0].tagName === "INPUT") { return }
  event.stopPropagation()
  last.tabIndex = 0  // the way on leads from here, not to the first one again
  setTimeout(() => { last.tabIndex = -1 })
}, {capture: true})
"""

# A key that is held down waits for the page: nothing is queued.
_KEYS = """
if (window.polywigner_keys) { return }
window.polywigner_keys = true
const moving = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"]
const others = ["n", "p", "N", "P", "Insert", "Delete", " ", "Escape"]
let last = 0
document.addEventListener("keydown", (event) => {
  const path = event.composedPath(), from = path[0]
  const typing = ["INPUT", "TEXTAREA", "SELECT"].includes(from.tagName)
  const figure = figures.find((figure) => path.includes(Bokeh.index.find_one(figure)?.el))
  const control = event.ctrlKey || event.metaKey
  let key = null
  if (control && !typing) {
    const letter = event.key.toLowerCase()
    if (letter === "z") { key = event.shiftKey ? "redo" : "undo" }
    if (letter === "y") { key = "redo" }
  }
  if (figure && !control && !event.altKey && [...moving, ...others].includes(event.key)) {
    key = event.key
  } else if (event.key === "Enter" && !typing && from.tagName !== "BUTTON") {
    key = "finish"
  } else if (event.key === "Escape") {
    key = "Escape"
  }
  if (key === null) { return }
  if (key !== "finish" && key !== "Escape") { event.preventDefault() }
  const now = Date.now()
  if (event.repeat && (now - last < 40 || (signals.data.busy[0] === 1 && now - last < 333))) {
    return
  }
  last = now
  keys.data = {key: [key], figure: [figure?.name ?? ""], shift: [event.shiftKey], time: [now]}
})
"""


def connect_access(session: Session) -> None:
    """Set roles and names of widgets that Bokeh leaves without, and the keys of the page."""
    controls, figures = session.controls, session.figures
    focus = InlineStyleSheet(css=theme.WIDGETS + _FOCUS)
    for widget in session.page.select({"type": Widget}):
        widget.stylesheets = [*widget.stylesheets, focus]
    headings = [controls.drawer, *(group.heading for group in controls.groups)]
    known: dict[str, Any] = {
        "sliders": [controls.coherence, controls.defocus, controls.distance],
        "groups": [(controls.part, "Part of F"), (controls.order, "Order of rays")],
        "toggles": [
            (controls.draw, "aria-pressed"),
            *((made, "aria-expanded") for made in headings),
        ],
        "texts": [
            (controls.message, "assertive", "Messages"),
            (controls.busy, "polite", "State of the computation"),
            (controls.values, "polite", "Values at the chosen point"),
            (controls.note, "polite", "About the near field"),
            (controls.tour_text, "polite", "Tour"),
        ],
        "figures": figures.all,
        "with_keys": WITH_KEYS,
        "ring": _RING,
        "side": session.page.children[1],
        "main": session.page.children[2],
    }
    ready = session.doc.js_on_event
    ready(DocumentReady, CustomJS(args=known, code=_ROLES))
    ready(DocumentReady, CustomJS(args={"table": controls.table}, code=_TABLE))
    with_keys = [made for made in figures.all if made.name in WITH_KEYS]
    known = {"keys": session.keys, "signals": session.signals, "figures": with_keys}
    ready(DocumentReady, CustomJS(args=known, code=_KEYS))
