"""The page that ``wakefold score`` writes: one HTML file, pictures inside."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from wakefold import plot
from wakefold.base.wording import counted, duration_text, number_text
from wakefold.forecast import pictures
from wakefold.forecast.classes import SHARES
from wakefold.forecast.scores import Scores
from wakefold.model.model import Model

STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#1c2a33;max-width:1080px;margin:2rem auto;padding:0 1rem}
h1{font-size:1.7rem;margin-bottom:.2rem} h2{margin-top:2.2rem;font-size:1.25rem}
img{max-width:100%;border:1px solid #d8dee2;border-radius:4px}
table{border-collapse:collapse;font-size:.82rem;font-variant-numeric:tabular-nums;display:block;overflow-x:auto}
th,td{padding:.22rem .6rem;text-align:right;border-bottom:1px solid #e4e8eb;white-space:nowrap}
th{background:#f3f6f8} td:first-child,th:first-child{text-align:left} .note{color:#54636d;font-size:.9rem}
"""


def write(scores: Scores, model: Model, out: Path) -> Path:
    """Write ``report.html`` and its pictures into a directory, which is made.

    Returns:
        the page.
    """
    out.mkdir(parents=True, exist_ok=True)
    best = scores.methods[0]
    number = scores.asked.asked
    h = int(np.flatnonzero(number * 2 >= number.max())[-1])  # the farthest that half of the questions are about
    figures = {
        "horizons": pictures.horizons(scores),
        "calibration": pictures.calibration(scores),
        "answers": pictures.answers(scores, model, best, h),
    }
    for name, figure in figures.items():
        plot.save(figure, out / f"{name}.png")
    page = out / "report.html"
    page.write_text(_page(scores, model, {name: out / f"{name}.png" for name in figures}), encoding="utf-8")
    return page


def _page(scores: Scores, model: Model, drawn: dict[str, Path]) -> str:
    asked, told = scores.asked, scores.to_dict()
    verdict = " ".join(scores.verdict())
    notes = "".join(f"<li>{escape(note)}</li>" for note in scores.notes)
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Wakefold: forecasts scored</title><style>{STYLE}</style></head><body>
<h1>Forecasts of {counted(len(asked.fixes), "held-out track")}</h1>
<p class="note">{escape(repr(model))}; {escape(scores.terms["asks"])}; seed {scores.seed}.</p>
<p>{escape(verdict)}</p>
{f"<p>To be noted:</p><ul>{notes}</ul>" if notes else ""}
<h2>Error against horizon</h2>
{_picture(drawn["horizons"], "Mean error and energy score of each method against the horizon")}
<p class="note">Bars are 90 % intervals over tracks. Error: distance from the geometric median of 100 samples to where
the agent was. Energy score: mean distance of a sample from there, less half the mean distance of two samples.</p>
{_errors(told, scores)}
<h2>How sure to be</h2>
{_picture(drawn["calibration"], "Truths in regions of a probability, likeliest classes that were right")}
<p class="note">On the dashed line a method is as often right as it says; below it, it is too sure. Below: the likeliest
class after half of a track, in bins of its probability; larger dots stand for more tracks.</p>
{_classes(told, scores)}
<h2>The best and the worst answers</h2>
{_picture(drawn["answers"], "Maps of the best and the worst answers")}
<p class="note">Of {escape(scores.methods[0])}, each of another track. The best are of agents that went at least as
far as the median; grey are past tracks.</p>
<h2>What was chosen</h2>
<p class="note">Settings of each method, on past tracks held back from its memory, by seconds ahead.</p>
<table><tr><th>method</th><th>settings</th></tr>{_settings(told)}</table>
</body></html>
"""


def _picture(path: Path, text: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{escape(text)}" src="data:image/png;base64,{data}">'


def _errors(told: dict[str, Any], scores: Scores) -> str:
    horizons = [h for h, n in told["questions"]["horizons"].items() if n]
    head = "".join(f"<th colspan=4>in {duration_text(float(h))}</th>" for h in horizons)
    under = "<th>error</th><th>energy</th><th>50 %</th><th>90 %</th>" * len(horizons)
    body = []
    for name in scores.methods:
        cells = [f"<td>{escape(name)}</td>"]
        rows = told["methods"][name].values()
        for row in (told["methods"][name].get(h) for h in horizons):
            if row is None:
                cells.append("<td></td>" * 4)
                continue
            cells.append(f"<td>{number_text(row['mean'])} ({number_text(row['median'])})</td>")
            cells.append(f"<td>{number_text(row['energy'])}</td>")
            cells.append(f"<td>{row['cover50']:.2f}</td><td>{row['cover90']:.2f}</td>")
        missing, few = sum(row["unanswered"] for row in rows), max((row["n"] for row in rows), default=0)
        cells.append(f"<td>{few:,}</td><td>{missing or ''}</td>")
        body.append(f"<tr>{''.join(cells)}</tr>")
    head += "<th></th><th></th>"
    return (
        f"<table><tr><th></th>{head}</tr><tr><th>mean (median), {scores.unit}</th>{under}<th>most questions</th>"
        f"<th>not answered</th></tr>{''.join(body)}</table>"
    )


def _classes(told: dict[str, Any], scores: Scores) -> str:
    if not scores.levels:
        return ""
    shares = [f"{100 * share:.0f}" for share in SHARES]
    out = []
    for level in (f"{b:g}" for b in scores.levels):
        head = "".join(f"<th colspan=3>after {share} %</th>" for share in shares)
        under = "<th>−log p</th><th>right</th><th>calibration error</th>" * len(shares)
        body = []
        for name, levels in told["classes"].items():
            cells = []
            for row in (levels[level].get(share) for share in shares):
                cells.append(
                    "<td></td>" * 3
                    if row is None
                    else f"<td>{row['nll']:.2f}</td><td>{row['accuracy']:.0%}</td><td>{row['ece']:.2f}</td>"
                )
            body.append(f"<tr><td>{escape(name)}</td>{''.join(cells)}</tr>")
        title = f"<p>Class of the whole track at {level} {scores.unit}</p>"
        out.append(f"{title}<table><tr><th></th>{head}</tr><tr><th></th>{under}</tr>{''.join(body)}</table>")
    return "".join(out)


def _settings(told: dict[str, Any]) -> str:
    return "".join(
        f"<tr><td>{escape(name)}</td><td>{escape(_said(setting))}</td></tr>"
        for name, setting in told["settings"].items()
    )


def _said(setting: dict[str, Any]) -> str:
    parts = []
    for name, value in setting.items():
        if isinstance(value, dict):
            inner = ", ".join(f"{key} {number_text(v) if isinstance(v, float) else v}" for key, v in value.items())
            parts.append(f"{name}: {inner}")
        else:
            parts.append(f"{name} {number_text(value) if isinstance(value, float) else value}")
    return "; ".join(parts)
