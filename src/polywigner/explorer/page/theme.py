"""Colours and sizes of the page, light and dark as the visitor's system has it."""

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
"""

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
"""

# Texts of figures are drawn, not styled: a theme is given to them here, and not told to the server.
PAINT = """
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
