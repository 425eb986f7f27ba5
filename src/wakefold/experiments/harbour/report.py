"""The page that the demo writes: one HTML file, pictures inside."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#1c2a33;max-width:1080px;margin:2rem auto;padding:0 1rem}
h1{font-size:1.7rem;margin-bottom:.2rem} h2{margin-top:2.2rem;font-size:1.25rem}
img{max-width:100%;border:1px solid #d8dee2;border-radius:4px}
table{border-collapse:collapse;font-size:.82rem;font-variant-numeric:tabular-nums;display:block;overflow-x:auto}
th,td{padding:.22rem .6rem;text-align:right;border-bottom:1px solid #e4e8eb;white-space:nowrap}
th{background:#f3f6f8} td:first-child,th:first-child,td.text{text-align:left}
tr.report td{background:#fff4d6} .best{font-weight:600} .note{color:#54636d;font-size:.9rem}
"""


def report_page(results: Mapping[str, Any], pictures: Mapping[str, Path]) -> str:
    """The page, from what ``wakefold.experiments.harbour.demo.run`` found and the pictures it drew."""
    learned, held_out, settings = results["learned"], results["held_out"], results["settings"]
    followed = results["followed"]
    report = next(step for step in followed["steps"] if step["evidence"].startswith("bound"))
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Wakefold: New York Harbor</title><style>{STYLE}</style></head><body>
<h1>New York Harbor, one belief at every scale</h1>
<p>{escape(" ".join(results["verdict"]))}</p>
<p class="note">Ship tracks (AIS) of December 2020 from the package tracktable-data. Learned on 1–7 December; everything
below the tree is about 8 December, which was used neither to learn nor to choose a setting of a filter.</p>

<h2>The tree of movement classes</h2>
<p>{learned["voyages"]:,} voyages of the week were joined into a tree by their Fréchet distance, the greatest distance
two ships would be apart if each sailed its own track, waiting for the other where it helps. Cut the tree at a distance
and the voyages fall into classes; the picture shows one such level. A voyage here is what a ship does between two stops
of ten minutes.</p>
{_picture(pictures["tree"], "Voyages coloured by class beside the tree of classes")}

<h2>One ship, followed</h2>
<p>Voyage <b>{escape(followed["voyage"])}</b> of 8 December: of the voyages of one to two hours the one that gets
farthest. Each row is a moment, each column a level of the tree; a class is the more strongly coloured the more probable
it is. First nothing is known. One fix leaves every track through that place. Then comes the coarse report
“{escape(report["evidence"])}” (simulated and true, held to be right with probability {settings["confidence"]:g}): it
speaks of the coarsest level only, yet sharpens all of them. From then on the filter sees a fix every two minutes. All
columns are sums over the same past voyages, so they never contradict each other.</p>
{_picture(pictures["belief"], "Probabilities of classes over time and level", 720)}
<p>Looking ahead at {results["forecast_at"][:5]}: where the filter expects the ship, where it went, and where it would
be at constant velocity.</p>
{_picture(pictures["forecast"], "Forecast for 5 and 15 minutes", 560)}

<h2>The same in numbers</h2>
<p>Most probable class at each of three levels and its probability; how far the estimate is from the ship, and the
forecasts for 5 and 15 minutes from where it was then (c.v.: at constant velocity), in metres.</p>
{_steps(followed["steps"], results["levels"])}
{_effect(results)}

<h2>All voyages of 8 December</h2>
<p>{held_out["voyages"]:,} voyages, {held_out["fixes"]:,} fixes two minutes apart or more. After each fix but the first
every method says where the ship will be, as long as the voyage lasts, by 100 samples. The best of each column
is bold.</p>
{_errors(results["scores"])}
<p class="note">{escape(results["scores"]["questions"]["asks"])}. Error: mean and (median) distance of the geometric
median of the samples from where the ship was, metres. Energy score: mean distance of a sample from there less half the
mean distance of two samples; it is small for answers that are near and that say how sure they are. 50 %, 90 %: how
often the ship was in the region of that probability. Plain methods are dressed with what they were wrong by on
voyages of the week held back from their memory. {_slow(results["scores"])}Fixes are AIS positions as received; BL1,
BL2 and MHPF take them to have a standard deviation of {settings["sd"]:g} m. {settings["particles"]:,} particles, ε
{settings["epsilon"]:g} m, motion noise {settings["scale"]:g} m/√s, chosen on 7 December with a model of 1–6 December.
Seed {settings["seed"]}. Made in {results["seconds"]:.0f} s.</p>
</body></html>
"""


def _picture(path: Path, text: str, width: int = 1080) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{escape(text)}" style="width:{width}px" src="data:image/png;base64,{data}">'


def _steps(steps: list[dict[str, Any]], levels: list[float]) -> str:
    ahead = list(dict.fromkeys(name for step in steps for name in step["forecast_error"]))
    head = "<th>time</th><th>evidence</th>" + "".join(f"<th>level {level:,.0f} m</th>" for level in levels)
    head += "<th>error</th>" + "".join(f"<th>in {name}</th><th>c.v.</th>" for name in ahead)
    rows = []
    for step in steps:
        cells = [f"<td>{step['time'][11:19]}</td><td class=text>{escape(step['evidence'])}</td>"]
        cells += [
            f"<td>{b['class']} <small>({b['tracks']:,})</small> {b['probability']:.0%}</td>" for b in step["best"]
        ]
        cells.append(f"<td>{step['position_error']:,.0f}</td>")
        for name in ahead:
            off = step["forecast_error"].get(name, {}).values()
            cells += [f"<td>{value:,.0f}</td>" for value in off] or ["<td></td><td></td>"]
        mark = ' class="report"' if step["evidence"].startswith("bound") else ""
        rows.append(f"<tr{mark}>{''.join(cells)}</tr>")
    note = '<p class="note">In brackets: the number of past voyages in the class.</p>'
    return f"<table><tr>{head}</tr>{''.join(rows)}</table>{note}"


def _effect(results: Mapping[str, Any]) -> str:
    """What the coarse report changed, level by level."""
    steps = results["followed"]["steps"]
    at = next(i for i, step in enumerate(steps) if step["evidence"].startswith("bound"))
    parts = [
        f"at {level:,.0f} m from class {a['class']} ({a['probability']:.0%}) to {b['class']} ({b['probability']:.0%})"
        for level, a, b in zip(results["levels"], steps[at - 1]["best"], steps[at]["best"], strict=True)
    ]
    return f"<p>The coarse report moved the most probable class {'; '.join(parts)}.</p>"


def _slow(scores: Mapping[str, Any]) -> str:
    """Which methods were asked about some fixes only."""
    most = max(sum(row["n"] for row in rows.values()) for rows in scores["methods"].values())
    few = [name for name, rows in scores["methods"].items() if sum(row["n"] for row in rows.values()) < most]
    return f"{escape(' and '.join(few))} are slow and were asked after some of the fixes only. " if few else ""


def _errors(scores: Mapping[str, Any]) -> str:
    """A row for each method, four columns for each horizon."""
    methods, horizons = scores["methods"], list(scores["questions"]["horizons"])
    head = "".join(f"<th colspan=4>in {float(h) / 60:.0f} min</th>" for h in horizons)
    under = "<th>error</th><th>energy</th><th>50 %</th><th>90 %</th>" * len(horizons)
    least = {
        (h, what): min(rows[h][what] for rows in methods.values() if h in rows)
        for h in horizons
        for what in ("mean", "energy")
    }
    body = []
    for name, rows in methods.items():
        cells = [f"<td>{escape(name)}</td>"]
        for h in horizons:
            if h not in rows:
                cells.append("<td></td>" * 4)
                continue
            row = rows[h]
            mean, energy = (
                f'<span class="best">{row[what]:,.0f}</span>' if row[what] == least[h, what] else f"{row[what]:,.0f}"
                for what in ("mean", "energy")
            )
            cells.append(f"<td>{mean} ({row['median']:,.0f})</td><td>{energy}</td>")
            cells.append(f"<td>{row['cover50']:.0%}</td><td>{row['cover90']:.0%}</td>")
        body.append(f"<tr>{''.join(cells)}</tr>")
    counts = "".join(f"<td colspan=4>{n:,}</td>" for n in scores["questions"]["horizons"].values())
    body.append(f"<tr><td>questions</td>{counts}</tr>")
    return f"<table><tr><th></th>{head}</tr><tr><th></th>{under}</tr>{''.join(body)}</table>"
