// The little that runs in the browser: texts, sizes of figures, outlines while they are dragged,
// keys, and names for screen readers. Arguments: told, heard, table, rows, figures, with_keys,
// outline, vertices, largest.
const place = (id) => document.getElementById(id)
const view_of = (model) => Bokeh.index.find_one(model)
const tagged = (tag) => {
  for (const model of Bokeh.documents[0].all_models) {
    if (model.tags.includes(tag)) { return view_of(model) }
  }
  return null
}
const tell = (kind, key, figure = "", shift = false) => {
  heard.data = {kind: [kind], key: [key], figure: [figure], shift: [shift], time: [Date.now()]}
}
const is_busy = () => told.data.kind[0] === "computing"

// Texts. Pictures of an older state are pale, but not those that are renewed soon.
let since = performance.now(), request = null, waiting = null
const paint = (pale) => {
  for (const figure of figures) {
    const old = told.data.stale[0].includes(figure.name), by = old ? "0.4" : ""
    const style = view_of(figure)?.el.style
    if (style && old === pale && style.opacity !== by) { style.opacity = by }
  }
}
const render = () => {
  const now = Object.fromEntries(Object.entries(told.data).map(([name, [value]]) => [name, value]))
  for (const name of ["status", "message", "values", "note", "tour"]) {
    if (place(name).pw !== now[name]) { place(name).pw = place(name).innerHTML = now[name] }
  }
  place("busy").className = now.kind
  if (now.request !== request) { request = now.request; since = performance.now() }
  if (!is_busy()) { place("elapsed").textContent = "" }
  clearTimeout(waiting)
  paint(false)
  waiting = setTimeout(() => paint(true), 700)
  if (now.point !== place("tour").point) {
    place("tour").point = now.point
    const figure = figures.find((figure) => figure.name === now.point)
    // once it is there: it may have been hidden
    if (figure) { setTimeout(() => view_of(figure)?.el.scrollIntoView({block: "nearest"}), 300) }
  }
}
told.properties.data.change.connect(render)
render()
setInterval(() => {  // counted here: the server may be at one long step
  const seconds = Math.round((performance.now() - since) / 1000)
  if (is_busy() && seconds >= 2) { place("elapsed").textContent = `${seconds} s` }
}, 500)
Bokeh.documents[0].on_event("connection_lost", () => {
  place("busy").className = "outdated"
  place("status").textContent = "not connected"
  place("message").innerHTML = '<div class="alert">The connection to the server is lost. Reload ' +
    "this page once polywigner explore runs again: its address has all that you drew.</div>"
})

// Sizes: all figures in view, or as wide as they may be. 64 x 106 pixels of a figure are its labels
// and its colour bar. Controls without room are closed at first, the last ones before the others.
const best = (count) => {
  const width = place("main").clientWidth - 10, height = place("main").clientHeight - 4
  let seen = [0, 1], wide = [0, 1]
  for (let columns = 1; columns <= 6; columns++) {
    const across = Math.floor(width / columns) - 64 - 8
    const down = Math.floor(height / Math.ceil(count / columns)) - 106 - 4
    if (Math.min(across, down) > seen[0]) { seen = [Math.min(across, down), columns] }
    if (across >= 240 || columns === 1) { wide = [across, columns] }
  }
  return seen[0] >= 240 ? seen : wide
}
const arrange = () => {
  const [side, columns] = best(figures.filter((figure) => figure.visible).length + 1)
  document.documentElement.style.setProperty("--pw-columns", columns)
  for (const figure of figures) {
    if (figure.frame_width !== side) { figure.setv({frame_width: side, frame_height: side}, {sync: false}) }
  }
}
const drawer = place("drawer"), groups = [...document.querySelectorAll("details")]
const toggle = (open) => {
  place("side").hidden = !open
  drawer.setAttribute("aria-expanded", open)
}
drawer.addEventListener("click", () => toggle(place("side").hidden))
if (window.innerWidth > 760) {
  setTimeout(() => {
    for (const group of groups.toReversed()) {
      if (place("side").scrollHeight > place("side").clientHeight) { group.open = false }
    }
  }, 300)  // once styles are there
} else { toggle(false) }
new ResizeObserver(arrange).observe(place("main"))
for (const figure of figures) {
  figure.properties.visible.change.connect(() => setTimeout(arrange))
  // a finger scrolls the page, but in the outline it moves vertices
  const element = view_of(figure)?.canvas_view?.events_el
  if (element && figure.name !== "aperture") { element.style.touchAction = "pan-y" }
}
// the wheel scrolls the page, with Ctrl it zooms a figure
document.addEventListener("wheel", (event) => {
  if (!event.ctrlKey && !event.metaKey) { event.stopPropagation() }
}, {capture: true})

// Texts of figures are drawn, not styled: they follow the system's colours here.
const dark = matchMedia("(prefers-color-scheme: dark)")
const colour = () => {
  const css = getComputedStyle(document.documentElement)
  const [text, faint, page] = ["--pw-text", "--pw-faint", "--pw-page"]
    .map((name) => css.getPropertyValue(name).trim())
  const set = (model, values) => model.setv(values, {sync: false})
  for (const figure of figures) {
    set(figure.title, {text_color: text})
    for (const part of [...figure.left, ...figure.below, ...figure.center]) {
      const known = {
        axis_label_text_color: text, major_label_text_color: text, label_text_color: text,
        axis_line_color: faint, major_tick_line_color: part.type === "ColorBar" ? page : faint,
      }
      if (part.type === "Grid") { continue }
      const its = Object.entries(known).filter(([name]) => name in part.properties)
      set(part, Object.fromEntries(its))
    }
    for (const {glyph} of figure.renderers) {
      if (glyph?.type === "Text") { set(glyph, {text_color: faint}) }
    }
  }
}
if (dark.matches) { colour() }
dark.addEventListener("change", colour)

// Outlines from vertices: when one was deleted, and while one is dragged. The next edit is sent when
// the last one has been answered, or after a third of a second; the place where a hand comes to
// rest is sent as well, though no event tells that it does.
const drawn = () => {
  const {x, y, ring} = vertices.data
  const xs = [], ys = [], number = []
  for (let k = 0; k < x.length; k++) {
    if (!number.includes(ring[k])) { number.push(ring[k]); xs.push([]); ys.push([]) }
    const there = number.indexOf(ring[k])
    xs[there].push(x[k]); ys[there].push(y[k])
  }
  const before = JSON.stringify([outline.data.xs, outline.data.ys])
  return JSON.stringify([xs, ys]) === before ? null : {xs, ys, number}
}
let sent = 0, drag = null, asked = false
told.properties.data.change.connect(() => { asked = asked && is_busy() })
vertices.properties.data.change.connect(() => {
  const data = drawn()
  if (data !== null) { outline.data = data }
})
const send = () => {
  const rest = sent + (asked ? 333 : 40) - Date.now()
  if (rest > 0) { drag = setTimeout(send, Math.min(rest, 20)); return }
  drag = null
  const data = drawn()
  if (data === null) { return }
  sent = Date.now()
  asked = true
  outline.data = data
}
figures[0].on_event("pan", () => {
  if (vertices.selected.indices.length > 0 && drag === null) { send() }
})

// Bokeh 3.9 leaves the cells of a table as they are where all rows are replaced. Its grid keeps the
// tabulator for its cells, and lets nobody out: cells are left to the arrows, with one stop before.
rows.properties.data.change.connect(() => {
  const view = view_of(table)
  if (view?.grid) { view.data.init(rows, table.view); view.grid.invalidate() }
})
const label = (element, text, role) => {
  element?.setAttribute("aria-label", text)
  if (role) { element?.setAttribute("role", role) }
}
const enter_table = () => {
  const {shadow_el, grid} = view_of(table)
  const stops = [...shadow_el.querySelectorAll("[tabindex='0']")]
  const first = stops[0], last = stops.at(-1)
  for (const stop of stops) { if (stop !== first) { stop.tabIndex = -1 } }
  for (const stop of [first, last]) {  // the last is where the grid puts the focus itself
    label(stop, "Vertices: arrows go from cell to cell, Enter edits one", "application")
  }
  first.addEventListener("focus", () => {
    if (!grid.getActiveCell() && grid.getDataLength() > 0) { grid.setActiveCell(0, 1) }
  })
  shadow_el.addEventListener("keydown", (event) => {
    if (event.key !== "Tab" || event.composedPath()[0].tagName === "INPUT") { return }
    event.stopPropagation()
    last.tabIndex = 0  // the way on leads from here, not to the first one again
    setTimeout(() => { last.tabIndex = -1 })
  }, {capture: true})
}
enter_table()

// Names and roles that Bokeh's widgets and figures come without.
const follow = (model, property, act) => { act(); model.properties[property].change.connect(act) }
for (const tag of ["coherence", "defocus", "distance"]) {
  const {model, shadow_el} = tagged(tag)
  follow(model, "title", () => label(shadow_el.querySelector(".noUi-handle"), model.title))
}
for (const [tag, text] of [["part", "Part of F"], ["order", "Order of rays"]]) {
  const {model, shadow_el} = tagged(tag)
  label(shadow_el.firstElementChild, text, "group")
  follow(model, "active", () => shadow_el.querySelectorAll("button").forEach((button, k) => {
    button.setAttribute("aria-pressed", k === model.active)
  }))
}
const draw = tagged("draw")
follow(draw.model, "active", () => {
  draw.shadow_el.querySelector("button").setAttribute("aria-pressed", draw.model.active)
})
for (const figure of figures) {
  const element = view_of(figure)?.canvas_view?.events_el, keys = with_keys[figure.name]
  if (!element) { continue }
  element.tabIndex = keys ? 0 : -1
  element.addEventListener("focus", () => {
    if (element.matches(":focus-visible")) { element.style.outline = "2px solid var(--pw-mark)" }
  })
  element.addEventListener("blur", () => { element.style.outline = "none" })
  follow(figure.title, "text", () => {
    label(element, figure.title.text + (keys ? `. ${keys}` : ""), keys ? "application" : "img")
  })
}

// Keys. One that is held down waits for the page: nothing is queued.
const moving = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"]
const others = ["n", "p", "N", "P", "Insert", "Delete", " ", "Escape"]
let last = 0
document.addEventListener("keydown", (event) => {
  const path = event.composedPath(), from = path[0]
  const typing = ["INPUT", "TEXTAREA", "SELECT"].includes(from.tagName)
  const figure = figures.find((made) => made.name in with_keys && path.includes(view_of(made)?.el))
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
  if (event.repeat && (now - last < 40 || (is_busy() && now - last < 333))) { return }
  last = now
  tell("key", key, figure?.name ?? "", event.shiftKey)
})

// A message beyond the server's limit ends the connection, and the page with it: files that are too
// large are not sent, only their names and sizes.
tagged("upload").shadow_el.addEventListener("change", (event) => {
  const {files} = event.target
  if (!files || files.length === 0 || files[0].size <= largest) { return }
  event.stopImmediatePropagation()
  tell("refused", files[0].name, "", files[0].size)
  event.target.value = ""
}, {capture: true})
