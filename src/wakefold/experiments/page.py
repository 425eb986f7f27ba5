"""The page that ``wakefold reproduce`` writes: one HTML file, pictures inside."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

from wakefold.experiments.registry import Claim, Picture, Section, Size, Table

STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#1c2a33;max-width:1120px;margin:2rem auto;padding:0 1rem}
h1{font-size:1.7rem;margin-bottom:.2rem}
h2{margin-top:2.6rem;font-size:1.3rem;border-top:1px solid #d8dee2;padding-top:1rem}
img{max-width:100%;border:1px solid #d8dee2;border-radius:4px} figure{margin:1rem 0}
figcaption,caption,.note{color:#54636d;font-size:.88rem;text-align:left}
table{border-collapse:collapse;font-size:.8rem;font-variant-numeric:tabular-nums}
table{display:block;overflow-x:auto;margin:1rem 0}
th,td{padding:.22rem .6rem;text-align:right;border-bottom:1px solid #e4e8eb;vertical-align:top;white-space:nowrap}
th{background:#f3f6f8;text-align:left} td:first-child{text-align:left}
.claims td{text-align:left;white-space:normal;min-width:6rem} .claims td:first-child{min-width:17rem}
.holds{background:#dff2e1} .depends{background:#fff1cc} .does{background:#f9d9d6}
"""


def page(sections: Sequence[Section], size: Size, seconds: float) -> str:
    """The whole page."""
    runs = f"{size.scenarios} × {size.repetitions} runs (tankers {size.tanker_scenarios} × {size.repetitions})"
    warning = "<p><b>A quick run: too few runs for any verdict.</b></p>" if size.quick else ""
    claims = [(section.title, claim) for section in sections for claim in section.claims]
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Wakefold: the experiments of the MHPF papers</title><style>{STYLE}</style></head><body>
<h1>The experiments of the MHPF papers, reproduced</h1>
<p class="note">Hawasly, Pokorny, Ramamoorthy: “Estimating Activity at Multiple Scales using Spatial Abstractions”
(arXiv 2016) and “Multi-Scale Activity Estimation with Spatial Abstractions” (GSI 2017). The papers' data were never
released: those here are generated, seed 0. {runs} of scenarios × repetitions, N = {size.particles}, 1 % of the classes
redrawn at each step, seed {size.seed}. Intervals are 95 %, over scenarios; tests are two-sided Wilcoxon signed-rank
tests over the means of the scenarios. Made in {seconds / 60:.1f} min.</p>
{warning}
<h2>All claims</h2>
{_claims(claims)}
{"".join(_section(section) for section in sections)}
</body></html>
"""


def _section(section: Section) -> str:
    parts = [f"<h2>{escape(section.title)}</h2>"]
    parts += [f"<p>{escape(text)}</p>" for text in section.text]
    parts += [_picture(picture) for picture in section.pictures]
    parts += [_claims([("", claim) for claim in section.claims])] if section.claims else []
    parts += [_table(table) for table in section.tables]
    parts += [f'<p class="note">{escape(text)}</p>' for text in section.notes]
    return "\n".join(parts)


def _picture(picture: Picture) -> str:
    data = base64.b64encode(picture.path.read_bytes()).decode()
    caption = escape(picture.caption)
    return (
        f'<figure><img alt="{caption}" style="width:{picture.width}px" src="data:image/png;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _claims(claims: Sequence[tuple[str, Claim]]) -> str:
    if not claims:
        return "<p>No claims to judge among the figures asked for.</p>"
    where = any(title for title, _ in claims)
    head = ["figure"] * where + ["claim", "published", "ours", "test", "verdict"]
    rows = []
    for title, claim in claims:
        cells = [title.split(":")[0]] * where + list(claim[:4])
        mark = claim.verdict.split(" ")[0] or "none"
        row = "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        rows.append(f'<tr>{row}<td class="{mark}">{escape(claim.verdict)}</td></tr>')
    return f'<table class="claims"><tr>{_head(head)}</tr>{"".join(rows)}</table>'


def _table(table: Table) -> str:
    rows = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in table.rows)
    return f"<table><caption>{escape(table.caption)}</caption><tr>{_head(table.head)}</tr>{rows}</table>"


def _head(names: Sequence[str]) -> str:
    return "".join(f"<th>{escape(name)}</th>" for name in names)
