"""The little that runs in the browser: vertices to outlines while they are dragged, downloads,
the address, the size of figures."""

from __future__ import annotations

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

# The page is laid out once for all figures: Bokeh would do it for each of their sizes, in seconds.
# 64 x 106 pixels of a figure are its labels and its colour bar. Controls that there is no room for
# are closed at first, the last ones before the others.
ARRANGE = """
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
  let left = window.innerHeight - 55 - 29 * groups.length
  groups.forEach((group, k) => { left -= heights[k]; group.active = left >= 0 })
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
"""Sizes of figures, open controls, and the action of the wheel over figures."""

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

# Bokeh 3.9 leaves the cells as they are where all rows are replaced.
REPAINT = """
const view = Bokeh.index.find_one(table)
if (view?.grid) { view.data.init(rows, table.view); view.grid.invalidate() }
"""
"""The cells of the table as its rows are."""

TEXTS = """
for (const model of texts) {
  const view = Bokeh.index.find_one(model)
  if (view?.markup_el) { view.rerender = () => { view.markup_el.innerHTML = model.text } }
}
"""
"""Texts in places of their own: Bokeh lays out the whole page anew for a word, in 40 ms."""

ELAPSED = """
let since = performance.now(), request = null
setInterval(() => {
  const line = Bokeh.index.find_one(busy)?.markup_el?.querySelector(".computing")
  const asked = line?.dataset.request ?? null
  if (asked !== request) { request = asked; since = performance.now() }
  const seconds = Math.round((performance.now() - since) / 1000)
  if (line && seconds >= 2) { line.querySelector(".elapsed").textContent = seconds + " s" }
}, 500)
"""
"""The seconds of a computation, counted by the page: the server may be at one long step."""

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
