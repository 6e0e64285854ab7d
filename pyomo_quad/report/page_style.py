"""How the HTML report looks: on a phone, on a screen and on paper."""

__all__ = ["STYLE_SHEET"]

STYLE_SHEET = """
:root { color-scheme: light; --ink: #1b1b1b; --muted: #555; --line: #d5d5d5; --good: #00664b;
  --bad: #9b2c00; }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0 auto; max-width: 58rem; padding: 1rem; background: #fff; color: var(--ink);
  font: 1rem/1.55 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .4rem 0 1rem; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; line-height: 1.3; margin: 2.4rem 0 .6rem; padding-top: .6rem;
  border-top: 1px solid var(--line); }
p, li, figcaption { overflow-wrap: break-word; max-width: 46rem; }
a { color: #00558a; }
a:focus-visible, .scroll:focus-visible { outline: 3px solid #e69f00; outline-offset: 2px; }
code { font: .92em ui-monospace, "DejaVu Sans Mono", monospace; overflow-wrap: anywhere; }
.verdict { border-left: .4rem solid var(--bad); background: #fdf3ee; padding: .8rem 1rem;
  font-size: 1.1rem; }
.verdict p { margin: 0; max-width: none; }
.verdict strong { color: var(--bad); }
.verdict.good { border-color: var(--good); background: #eef7f4; }
.verdict.good strong { color: var(--good); }
nav ul { display: flex; flex-wrap: wrap; gap: 0 1rem; list-style: none; margin: 1rem 0;
  padding: 0; }
nav a { display: inline-block; padding: .35rem 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .92em; }
caption { text-align: left; font-weight: 600; padding: .3rem 0; }
th, td { border-bottom: 1px solid var(--line); padding: .35rem .9rem .35rem 0; text-align: left;
  vertical-align: top; }
th.number { min-width: 4.6rem; }
thead th { border-bottom: 2px solid var(--muted); vertical-align: bottom; }
tbody th { font-weight: 400; white-space: nowrap; position: sticky; left: 0; background: #fff; }
th.number, td.number { text-align: right; }
td.number { white-space: nowrap; }
figure { margin: 1rem 0; }
figure img { display: block; width: 100%; min-width: 40rem; height: auto; }
figcaption, .note { color: var(--muted); font-size: .9em; }
.view { width: 100%; height: min(70vh, 34rem); min-height: 20rem;
  overflow: hidden; }
.skip { position: absolute; left: -999rem; }
.skip:focus { position: static; }
footer { margin: 2rem 0 1rem; color: var(--muted); font-size: .9rem; }
@media print {
  @page { size: A4; margin: 15mm; }
  body { max-width: none; padding: 0; font-size: 9.5pt; }
  h1 { font-size: 16pt; }
  h2 { font-size: 12pt; margin-top: 1.4rem; break-after: avoid; }
  table { font-size: 8pt; }
  th, td { padding: .15rem .5rem .15rem 0; }
  th.number { min-width: 0; }
  figure, table, .verdict { break-inside: avoid; }
  figure img { min-width: 0; max-height: 225mm; object-fit: contain; object-position: left; }
  .scroll { overflow: visible; }
  .verdict { border: 1.5pt solid; background: none; font-size: 10.5pt; }
  nav, .skip, .screen { display: none; }
  a { color: inherit; text-decoration: none; }
}
"""
