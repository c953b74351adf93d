"""The little that runs in the browser: vertices to outlines while they are dragged, downloads,
the address, the size of figures."""

from __future__ import annotations

__all__ = [
    "ADDRESS", "ARRANGE", "DOWNLOAD", "DRAG", "LOST", "QUICK_PAINT", "REBUILD", "SCROLL",
    "TEXTS", "UPLOAD",
]  # fmt: skip

_OUTLINE = """
const drawn = () => {
  const {x, y, ring} = vertices.data
  const xs = [], ys = [], found = new Map()
  for (let k = 0; k < x.length; k++) {
    if (!found.has(ring[k])) { found.set(ring[k], xs.length); xs.push([]); ys.push([]) }
    xs[found.get(ring[k])].push(x[k]); ys[found.get(ring[k])].push(y[k])
  }
  const before = JSON.stringify([outline.data.xs, outline.data.ys])
  return JSON.stringify([xs, ys]) === before ? null : {xs, ys}
}
"""

REBUILD = (
    _OUTLINE
    + """
const data = drawn()
if (data !== null) { outline.data = data }
"""
)
"""When vertices have changed: a drag has ended, one was deleted."""

# The next edit is sent when the last one has been answered, or after a third of a second; the
# place where a hand comes to rest is sent as well, though no event tells that it does.
DRAG = (
    """
if (vertices.selected.indices.length === 0) { return }
"""
    + _OUTLINE
    + """
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

DOWNLOAD = """
const {name, kind, content} = files.data
if (name.length === 0) { return }
const bytes = Uint8Array.from(atob(content[0]), (c) => c.charCodeAt(0))
const link = document.createElement("a")
link.href = URL.createObjectURL(new Blob([bytes], {type: kind[0]}))
link.download = name[0]
link.click()
setTimeout(() => URL.revokeObjectURL(link.href), 10000)
"""

# Once at rest: browsers take some milliseconds for it, and refuse it when asked too often.
ADDRESS = """
clearTimeout(window.polywigner_address)
window.polywigner_address = setTimeout(() => {
  history.replaceState(null, "", location.pathname + "?" + link.value)
}, 200)
"""

# Of a figure's width, 118 pixels are labels and its colour bar. The page is laid out once for all
# figures: Bokeh would do it for each of their sizes, in seconds.
ARRANGE = """
const arrange = () => {
  const {clientWidth} = document.documentElement
  const room = clientWidth - (clientWidth > narrow ? beside : 0) - 12
  const columns = Math.max(1, Math.min(4, Math.floor(room / 310)))
  const side = Math.max(190, Math.min(420, Math.floor(room / columns) - 118))
  document.documentElement.style.setProperty("--polywigner-columns", columns)
  if (figures[0].frame_width === side) { return }
  for (const figure of figures) {
    figure.setv({frame_width: side, frame_height: side}, {silent: true})
  }
  Bokeh.index.find_one(page).invalidate_layout()
}
arrange()
window.addEventListener("resize", arrange)
// the wheel scrolls the page, with Ctrl it zooms a figure
document.addEventListener("wheel", (event) => {
  if (!event.ctrlKey && !event.metaKey) { event.stopPropagation() }
}, {capture: true})
"""
"""The size of figures, and what the wheel does over them."""

SCROLL = """
const [name] = pointed.data.figure
const figure = figures.find((figure) => figure.name === name)
// once it is there: it may have been hidden
setTimeout(() => Bokeh.index.find_one(figure)?.el.scrollIntoView({block: "nearest"}), 300)
"""
"""The figure that the tour is at comes into view."""

LOST = """
busy.text = "not connected"
message.text = '<div style="color:#b00020">The connection to the server is lost. Reload this ' +
  'page once polywigner explore runs again: its address has all that you drew.</div>'
"""
"""Said by the page itself: nobody else can."""

# A message beyond the server's limit ends the connection, and the page with it.
UPLOAD = """
const view = Bokeh.index.find_one(upload)
view.shadow_el.addEventListener("change", (event) => {
  const {files} = event.target
  if (!files || files.length === 0 || files[0].size <= largest) { return }
  event.stopImmediatePropagation()
  refused.data = {name: [files[0].name], size: [files[0].size], time: [Date.now()]}
  event.target.value = ""
}, {capture: true})
"""
"""Files that are too large are not sent, only their names and sizes."""

# At every paint Bokeh asks for a style sheet's value of each property of each label, and writes the
# places of all parts of a figure anew, after which the browser works out all styles for the next
# question: half of the time. Figures have no such values here, and their parts stay where they are.
QUICK_PAINT = """
const replaced = (object, name, by) => {
  let owner = object ?? null
  while (owner !== null && !Object.hasOwn(owner, name)) { owner = Object.getPrototypeOf(owner) }
  if (owner !== null) { owner[name] = by(owner[name]) }
}
const view = Bokeh.index.find_one(figure)
const [part] = view?.renderer_views?.values() ?? []
replaced(view?.visuals?.outline_line, "_get_css_value", () => () => "")
replaced(part?.position, "_update", (update) => function (css) {
  if (this.el.textContent !== css) { update.call(this, css) }
})
"""

TEXTS = """
for (const model of texts) {
  const view = Bokeh.index.find_one(model)
  if (view?.markup_el) { view.rerender = () => { view.markup_el.innerHTML = model.text } }
}
"""
"""Texts in places of their own: Bokeh lays out the whole page anew for a word, in 40 ms."""
