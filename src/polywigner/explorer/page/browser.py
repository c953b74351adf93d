"""Scripts and styles of the browser: drags, downloads, sizes, keys, screen readers, colours.

Scripts see the models of the page by the names that ``session`` gives them.
"""

from __future__ import annotations

NARROW = 760
"""Width of a window in pixels below which the controls lie over the figures."""
_SIDE = 292

TEMPLATE = """{% block preamble %}
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
{% endblock %}
{% block postamble %}
<style>
:root { color-scheme: light dark;
  --pw-page: #ffffff; --pw-panel: #f5f7f9; --pw-text: #1b232b; --pw-faint: #55616c;
  --pw-line: #d5dbe1; --pw-field: #ffffff; --pw-over: #e9eef3; --pw-mark: #1f5f99;
  --pw-alert: #b00020; --pw-ready: #2c8a4b; --pw-wait: #b36b00; }
@media (prefers-color-scheme: dark) { :root {
  --pw-page: #12161a; --pw-panel: #191f25; --pw-text: #e3e8ed; --pw-faint: #9aa7b3;
  --pw-line: #323c46; --pw-field: #212930; --pw-over: #2b353e; --pw-mark: #7fb8ea;
  --pw-alert: #ff8080; --pw-ready: #63c384; --pw-wait: #f0b04a; } }
html, body { height: 100%; margin: 0; overflow: hidden; background: var(--pw-page);
  color: var(--pw-text); font: 13px/1.35 system-ui, sans-serif; }
</style>
{% endblock %}
{% block contents %}
<style>body:has(> [class*="bk-"]) > .waiting { display: none }</style>
<p class="waiting">polywigner explore makes this page. Reload it if nothing appears within a
minute: too many pages are open then, or the server has stopped.</p>
{{ super() }}
{% endblock %}
"""
"""The page before its own root is there, which hides the line of text."""

# Both parts scroll by themselves: who moves a slider sees the figure that it moves.
PAGE = """
:host { display: grid !important; width: 100vw !important; height: 100dvh !important;
  grid-template: auto minmax(0, 1fr) / var(--pw-side, max-content) minmax(0, 1fr);
  overflow: hidden; }
"""
HEAD = f"""
:host {{ grid-column: 1 / 3; width: auto !important; align-items: center; flex-wrap: wrap;
  padding: 5px 4px; row-gap: 4px; background: var(--pw-panel); z-index: 40;
  border-bottom: 1px solid var(--pw-line); }}
@media (max-width: {NARROW}px) {{ :host {{ font-size: 12px; }} }}
"""
SIDE = f"""
:host {{ grid-area: 2 / 1; display: var(--pw-controls, flex) !important;
  width: {_SIDE}px !important; height: 100% !important; overflow: hidden auto;
  box-sizing: border-box; padding: 4px 0;
  background: var(--pw-panel); border-right: 1px solid var(--pw-line); scrollbar-width: thin;
  z-index: 30; }}
@media (max-width: {NARROW}px) {{
  :host {{ grid-column: 1 / 3; width: 100% !important; border-right: none; }}
}}
"""
MAIN = f"""
:host {{ grid-area: 2 / 2; width: auto !important; height: 100% !important; overflow: hidden auto;
  scrollbar-width: thin; }}
@media (max-width: {NARROW}px) {{ :host {{ grid-column: 1 / 3; }} }}
"""
GRID = """
:host { display: grid !important; flex: none !important; width: 100% !important;
  height: max-content !important; min-height: 100%; grid-auto-rows: max-content;
  grid-template-columns: repeat(var(--pw-columns, 3), max-content);
  justify-content: space-evenly; align-content: space-evenly; align-items: start; }
"""
BUSY = f"""
:host {{ display: grid !important; align-content: center; }}
@media (max-width: {NARROW}px) {{ :host {{ order: 1; flex: 1 1 150px !important; width: auto; }} }}
"""
MESSAGE = f"""
:host {{ display: grid !important; align-content: safe center; }}
@media (max-width: {NARROW}px) {{ :host {{ order: 2; flex: 1 0 100% !important; height: 18px; }} }}
"""
# As wide as the figures of its column, which it must not widen.
POINT = """
:host { width: 0 !important; min-width: calc(100% - 16px); margin: 4px 8px; align-self: start;
  box-sizing: border-box; }
"""

WIDGETS = """
:host { color: var(--pw-text); font-size: 12.5px; --color: var(--pw-text);
  --background-color: var(--pw-field); --border: 1px solid var(--pw-line);
  --placeholder-color: var(--pw-faint); --disabled-background-color: var(--pw-panel);
  --padding-vertical: 4px; --padding-horizontal: 8px; --font-size: 12.5px;
  --default: var(--pw-field); --default-border: var(--pw-line); --default-hover: var(--pw-over);
  --default-hover-border: var(--pw-line); --default-active: var(--pw-over);
  --default-active-border: var(--pw-mark); --default-disabled: var(--pw-panel);
  --default-disabled-border: var(--pw-line); --file: var(--pw-over); --file-border: transparent;
  --file-hover: var(--pw-line); }
.bk-input { color: var(--pw-text); font-size: 12.5px; min-height: 27px; box-sizing: border-box; }
select.bk-input { appearance: auto !important; background-image: none !important; padding: 0 4px; }
.bk-input-group > label { font-size: 11.5px; color: var(--pw-faint); }
.bk-input-group.bk-inline { flex-wrap: wrap; gap: 2px 10px; font-size: 12.5px; }
.bk-input-group.bk-inline > *:not(:first-child) { margin-left: 0; }
textarea.bk-input { font-family: ui-monospace, monospace; font-size: 11.5px; }
.bk-btn { font-size: 12.5px; }
.bk-active.bk-btn-default { color: var(--pw-mark); font-weight: 600; }
:host(.heading) .bk-btn { text-align: left; font-weight: 600; border: none; padding: 6px 12px;
  border-top: 1px solid var(--pw-line); border-radius: 0; background: none; box-shadow: none;
  color: var(--pw-text); }
:host(.heading) .bk-btn:hover { background: var(--pw-over); }
:host(.heading) .bk-btn::before { content: "\\25B8"; display: inline-block; width: 16px;
  color: var(--pw-faint); }
:host(.heading) .bk-btn.bk-active::before { content: "\\25BE"; }
.noUi-target { background: var(--pw-over); border-color: var(--pw-line); box-shadow: none; }
.noUi-connects, .noUi-connect { background: var(--pw-line); }
.noUi-handle { background: var(--pw-field); border-color: var(--pw-faint); box-shadow: none; }
.slick-viewport, .slick-row, .slick-header, .slick-header-column, .slick-cell {
  background: var(--pw-field) !important; color: var(--pw-text) !important;
  border-color: var(--pw-line) !important; font-size: 12.5px; }
.slick-row.odd .slick-cell { background: var(--pw-panel) !important; }
.slick-cell.selected { background: var(--pw-over) !important; }
.slick-cell input { color: var(--pw-text); background: var(--pw-field); }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
td { padding: 1px 12px 1px 0; }
td:first-child { color: var(--pw-faint); }
[data-request]::before { content: ""; display: inline-block; width: 8px; height: 8px;
  margin-right: 6px; border-radius: 4px; background: var(--pw-wait); }
.ready::before { background: var(--pw-ready); }
.outdated::before { background: var(--pw-alert); }
.alert { color: var(--pw-alert); } .hint { color: var(--pw-mark); }
.bk-btn:focus-visible, .bk-input:focus-visible, input:focus-visible, .noUi-handle:focus-visible {
  outline: 2px solid var(--pw-mark) !important; outline-offset: 1px; }
:host(.bk-DataTable:focus-within) { outline: 2px solid var(--pw-mark); }
:host .slick-cell.active { border: 2px solid var(--pw-mark); }
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

# --- Vertices to outlines

_OUTLINE = """
const drawn = () => {
  const {x, y, ring} = vertices.data
  const xs = [], ys = [], number = []
  for (let k = 0; k < x.length; k++) {
    if (!number.includes(ring[k])) { number.push(ring[k]); xs.push([]); ys.push([]) }
    const place = number.indexOf(ring[k])
    xs[place].push(x[k]); ys[place].push(y[k])
  }
  const before = JSON.stringify([outline.data.xs, outline.data.ys])
  return JSON.stringify([xs, ys]) === before ? null : {xs, ys, number}
}
"""
REBUILD = _OUTLINE + "const data = drawn()\nif (data !== null) { outline.data = data }"
"""When vertices have changed: a drag has ended, one was deleted."""

# The next edit is sent when the last one has been answered, or after a third of a second; the
# place where a hand comes to rest is sent as well, though no event tells that it does.
DRAG = (
    _OUTLINE
    + """
if (vertices.selected.indices.length === 0) { return }
const send = () => {
  const sent = window.polywigner_sent ?? 0
  const rest = sent + (signals.data.busy[0] === 1 ? 333 : 40) - Date.now()
  if (rest > 0) { window.polywigner_drag = setTimeout(send, Math.min(rest, 20)); return }
  window.polywigner_drag = null
  const data = drawn()
  if (data === null) { return }
  window.polywigner_sent = Date.now()
  signals.data = {busy: [1]}
  outline.data = data
}
if ((window.polywigner_drag ?? null) === null) { send() }
"""
)
"""While a vertex is dragged."""

# --- When a model has changed

DOWNLOAD = """
const {name, kind, content} = files.data
if (name.length === 0) { return }
const bytes = Uint8Array.from(atob(content[0]), (c) => c.charCodeAt(0))
const anchor = document.createElement("a")
anchor.href = URL.createObjectURL(new Blob([bytes], {type: kind[0]}))
anchor.download = name[0]
anchor.click()
setTimeout(() => URL.revokeObjectURL(anchor.href), 10000)
"""

# Once at rest: browsers take some milliseconds for it, and refuse it when asked too often.
ADDRESS = """
clearTimeout(window.polywigner_address)
window.polywigner_address = setTimeout(() => {
  history.replaceState(null, "", location.pathname + "?" + link.value)
}, 200)
"""

SCROLL = """
const [name] = pointed.data.figure
const figure = figures.find((figure) => figure.name === name)
// once it is there: it may have been hidden
setTimeout(() => Bokeh.index.find_one(figure)?.el.scrollIntoView({block: "nearest"}), 300)
"""
"""The figure that the tour is at comes into view."""

LOST = """
busy.text = '<span class="outdated" data-request="0">not connected</span>'
message.text = '<div class="alert">The connection to the server is lost. Reload this ' +
  'page once polywigner explore runs again: its address has all that you drew.</div>'
"""
"""Said by the page itself: nobody else can."""

# Bokeh 3.9 leaves the cells as they are where all rows are replaced.
REPAINT = """
const view = Bokeh.index.find_one(table)
if (view?.grid) { view.data.init(rows, table.view); view.grid.invalidate() }
"""
"""The cells of the table as its rows are."""

STALE = """
const paint = (pale) => {
  for (const figure of figures) {
    const old = stale.data.figure.includes(figure.name), by = old ? "0.4" : ""
    const style = Bokeh.index.find_one(figure)?.el.style
    if (style && old === pale && style.opacity !== by) { style.opacity = by }
  }
}
clearTimeout(window.polywigner_stale)
paint(false)
window.polywigner_stale = setTimeout(() => paint(true), 700)  // what comes soon changes no style
"""
"""Pictures of an older state are pale."""

# --- Once the page is there

# The page is laid out once for all figures: Bokeh would do it for each of their sizes, in seconds.
# 64 x 106 pixels of a figure are its labels and its colour bar. Controls that there is no room for
# are closed at first, the last ones before the others.
_ARRANGE = """
const room = () => {
  const {offsetWidth, clientHeight} = Bokeh.index.find_one(main).el
  return [offsetWidth - 10, clientHeight - 4]
}
const best = (count) => {
  const [width, height] = room()
  let seen = [0, 1], wide = [0, 1]  // all figures in view, or as wide as they may be
  for (let columns = 1; columns <= 6; columns++) {
    const across = Math.floor(width / columns) - 64 - 8
    const down = Math.floor(height / Math.ceil(count / columns)) - 106 - 4
    if (Math.min(across, down) > seen[0]) { seen = [Math.min(across, down), columns] }
    const beside = across - Math.ceil(15 / columns)  // a bar to scroll stands at the right
    if (beside >= 240 || columns === 1) { wide = [beside, columns] }
  }
  return seen[0] >= 240 ? seen : wide
}
const arrange = () => {
  const count = figures.filter((figure) => figure.visible).length + 1
  const [side, columns] = best(count)
  document.documentElement.style.setProperty("--pw-columns", columns)
  if (figures[0].frame_width === side) { return }
  for (const figure of figures) {
    figure.setv({frame_width: side, frame_height: side}, {silent: true})
  }
  Bokeh.index.find_one(page).invalidate_layout()
}
const toggled = () => {
  document.documentElement.style.setProperty("--pw-controls", drawer.active ? "flex" : "none")
  document.documentElement.style.setProperty("--pw-side", drawer.active ? "max-content" : "0px")
}
if (window.innerWidth > narrow) {
  let left = window.innerHeight - 55 - 29 * headings.length
  headings.forEach((group, k) => { left -= heights[k]; group.active = left >= 0 })
} else { drawer.active = false }
drawer.properties.active.change.connect(toggled)
toggled()
new ResizeObserver(arrange).observe(Bokeh.index.find_one(main).el)
// a finger scrolls the page, but in the outline it moves vertices
for (const figure of figures) {
  figure.properties.visible.change.connect(() => setTimeout(arrange))
  const element = Bokeh.index.find_one(figure)?.canvas_view?.events_el
  if (element && figure.name !== "aperture") { element.style.touchAction = "pan-y" }
}
// the wheel scrolls the page, with Ctrl it zooms a figure
document.addEventListener("wheel", (event) => {
  if (!event.ctrlKey && !event.metaKey) { event.stopPropagation() }
}, {capture: true})
"""

# A message beyond the server's limit ends the connection, and the page with it: of files that are
# too large only names and sizes are sent.
_UPLOAD = """
const view = Bokeh.index.find_one(upload)
view.shadow_el.addEventListener("change", (event) => {
  const {files} = event.target
  if (!files || files.length === 0 || files[0].size <= largest) { return }
  event.stopImmediatePropagation()
  refused.data = {name: [files[0].name], size: [files[0].size], time: [Date.now()]}
  event.target.value = ""
}, {capture: true})
"""

# At every paint Bokeh asks for a style sheet's value of each property of each label, and writes the
# places of all parts of a figure anew, after which the browser works out all styles for the next
# question: half of the time. Figures have no such values here, and their parts stay where they are.
_QUICK_PAINT = """
const replaced = (object, name, by) => {
  let owner = object ?? null
  while (owner !== null && !Object.hasOwn(owner, name)) { owner = Object.getPrototypeOf(owner) }
  if (owner !== null) { owner[name] = by(owner[name]) }
}
const view = Bokeh.index.find_one(figures[0])
const [part] = view?.renderer_views?.values() ?? []
replaced(view?.visuals?.outline_line, "_get_css_value", () => () => "")
replaced(part?.position, "_update", (update) => function (css) {
  if (this.el.textContent !== css) { update.call(this, css) }
})
"""

# Texts in places of their own: Bokeh lays out the whole page anew for a word, in 40 ms.
_TEXTS = """
for (const model of texts) {
  const view = Bokeh.index.find_one(model)
  if (view?.markup_el) { view.rerender = () => { view.markup_el.innerHTML = model.text } }
}
"""

# The seconds of a computation, counted by the page: the server may be at one long step.
_ELAPSED = """
let since = performance.now(), request = null
setInterval(() => {
  const line = Bokeh.index.find_one(busy)?.markup_el?.querySelector(".computing")
  const asked = line?.dataset.request ?? null
  if (asked !== request) { request = asked; since = performance.now() }
  const seconds = Math.round((performance.now() - since) / 1000)
  if (line && seconds >= 2) { line.querySelector(".elapsed").textContent = seconds + " s" }
}, 500)
"""

# Texts of figures are drawn, not styled: a theme is given to them here, and not told to the server.
_PAINT = """
const dark = matchMedia("(prefers-color-scheme: dark)")
const paint = () => {
  const css = getComputedStyle(document.documentElement)
  const [text, faint, page] = ["--pw-text", "--pw-faint", "--pw-page"]
    .map((name) => css.getPropertyValue(name).trim())
  const set = (model, values) => model.setv(values, {sync: false})
  for (const figure of figures) {
    set(figure.title, {text_color: text})
    for (const part of [...figure.left, ...figure.below, ...figure.center]) {
      const known = {
        axis_label_text_color: text, major_label_text_color: text, label_text_color: text,
        axis_line_color: faint, major_tick_line_color: faint,
      }
      if (part.type === "ColorBar") { known.major_tick_line_color = page }
      if (part.type === "Grid") { continue }
      const its = Object.entries(known).filter(([name]) => name in part.properties)
      set(part, Object.fromEntries(its))
    }
    for (const {glyph} of figure.renderers) {
      if (glyph?.type === "Text") { set(glyph, {text_color: faint}) }
    }
  }
}
if (dark.matches) { paint() }
dark.addEventListener("change", paint)
"""

# Roles and names of widgets that Bokeh leaves without.
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
for (const [model, attribute, label] of pressed) {
  const shadow_el = view_of(model)?.shadow_el
  if (!shadow_el) { continue }
  if (label) { named(shadow_el.firstElementChild, "group", label) }
  const press = () => shadow_el.querySelectorAll("button").forEach((button, k) => {
    button.setAttribute(attribute, model.active === true || model.active === k)
  })
  press()
  model.properties.active.change.connect(press)
}
for (const [text, how, label] of live) {
  const {el} = view_of(text)
  named(el, how === "assertive" ? "alert" : "status", label)
  el.setAttribute("aria-live", how)
}
for (const figure of figures) {
  const view = view_of(figure), keys = with_keys[figure.name]
  const element = view?.canvas_view?.events_el
  if (!element) { continue }
  element.tabIndex = keys ? 0 : -1
  element.addEventListener("focus", () => {
    if (element.matches(":focus-visible")) { element.style.outline = "2px solid var(--pw-mark)" }
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
  const figure = figures.find((figure) => with_keys[figure.name] &&
    path.includes(Bokeh.index.find_one(figure)?.el))
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

READY = (
    _ARRANGE, _QUICK_PAINT, _PAINT, _UPLOAD, _TEXTS, _ELAPSED, STALE, _ROLES, _TABLE, _KEYS,
)  # fmt: skip
"""Scripts to run when the page is there."""
