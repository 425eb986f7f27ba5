"""``wakefold reproduce``: every figure gives its part of one page, and claims are judged as stated."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest
from typer.testing import CliRunner

from wakefold.base.parallel import Threads
from wakefold.cli import app
from wakefold.experiments import registry, stats
from wakefold.experiments.mhpf import fig2, fig7a, fig7b, fig9, grid, mse
from wakefold.experiments.registry import FIGURES, QUICK, Claim, Job, Section, Size, experiment
from wakefold.experiments.reproduce import reproduce

TINY = Size(scenarios=2, repetitions=1, tanker_scenarios=2, particles=20, quick=True)
PICTURES = ["fig1", "fig2", "fig3", "fig5", "fig6", "fig8"]


class Pictures(HTMLParser):
    """Counts pictures, and checks that elements are closed in the order they were opened."""

    def __init__(self):
        super().__init__()
        self.open, self.found = [], 0

    def handle_starttag(self, tag, attrs):
        self.found += tag == "img" and dict(attrs)["src"].startswith("data:image/png;base64,")
        if tag not in ("img", "meta"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_every_figure_is_an_experiment():
    for name in FIGURES:
        module = experiment(name)
        assert module.TITLE
        jobs = module.jobs(QUICK)
        assert all(json.loads(json.dumps(job.spec)) == job.spec for job in jobs)
        once = [j.spec for j in jobs if j.spec.get("method", {}).get("filter") != "calibrated"]  # alike for every κ
        assert len({json.dumps(spec) for spec in once}) == len(once)
    with pytest.raises(ValueError, match="no figure 'fig99'; there are fig1, "):
        experiment("fig99")


def test_pictures_and_their_page(tmp_path):
    said = []
    page = reproduce(PICTURES, TINY, tmp_path, Threads(1), say=said.append)
    text = page.read_text()
    found = Pictures()
    found.feed(text)
    assert not found.open
    assert found.found == len(PICTURES)
    assert "too few runs for any verdict" in text
    assert any(line.startswith("fig2: The report makes the class it names more probable") for line in said)


def test_a_report_that_does_not_raise_its_class_fails_figure_2():
    before = {"before the report": 0.4}
    assert fig2._raised(before | {"gsi2017": 0.7, "arxiv2016": 0.5}).verdict == "holds"
    assert fig2._raised(before | {"gsi2017": 0.7, "arxiv2016": 0.4}).verdict == "does not hold"


@pytest.mark.parametrize(
    ("name", "module", "kept"),
    [("mse", mse, slice(4, 5)), ("fig7a", fig7a, slice(1)), ("fig7b", fig7b, slice(1)), ("fig9", fig9, slice(1))],
)
def test_comparisons_on_a_small_grid(name, module, kept, tmp_path, monkeypatch):
    half = len(module.SETTINGS) // 2
    out = module.SETTINGS[:half][kept]
    settings = [*out, *(s._replace(truth="in") for s in out)]
    monkeypatch.setattr(module, "SETTINGS", settings)
    monkeypatch.setattr(module, "OUT", out, raising=False)
    if name == "fig9":  # learning what reports are worth among 194 tankers takes its time
        monkeypatch.setattr(module, "SHARP", [s._replace(spread=s.psi / 100, told_by="all") for s in settings])
        monkeypatch.setattr(module, "NAMING", grid.LOG[:-1])
    for constant in ("KAPPA", "LEVELS"):
        if hasattr(module, constant):
            monkeypatch.setattr(module, constant, (out[0].kappa,))
    shares = []
    page = reproduce([name], TINY, tmp_path, Threads(1), shares.append, say=lambda line: None)
    assert shares[-1] == 1
    text = page.read_text()
    assert "BL1+coarse" in text
    assert "arxiv2016" in text
    assert "gsi2017" in text
    assert not re.search(r"<td>nan|>inf", text)


def test_a_claim_is_judged_by_its_numbers():
    found = {}
    for truth, better in (("out", True), ("in", False)):
        for method, value in (
            (grid.PUBLISHED[0], 1.0),
            (grid.PUBLISHED[1], 2.0),
            (grid.BL1, 2.0),
            (grid.BL1_COARSE, 3.0),
        ):
            low = value if better else 4.0 - value
            runs = low + 0.01 * np.arange(20).reshape(10, 2)
            scores = grid.Scores(*(runs for _ in grid.Scores._fields))
            found[fig7a.OUT[0]._replace(truth=truth), method] = scores
    claims = grid.claims_below(found, fig7a.OUT[:1], "distance", "One", "published", 0.05)
    assert [c.verdict for c in claims] == [grid.DEPENDS, grid.FAILS, grid.DEPENDS, grid.DEPENDS]
    assert "below in 1 of 1" in claims[0].ours
    assert claims[0].test.startswith("p = 0.002;")


def test_statistics_are_those_of_scenarios():
    runs = np.array([[1.0, 3.0], [2.0, 6.0], [0.0, 6.0]])
    assert stats.scenario_means(runs).tolist() == [2, 4, 3]
    assert stats.half_width([2, 4, 3]) == pytest.approx(4.3027 / np.sqrt(3), rel=1e-4)
    a = np.linspace(1, 2, 10)
    ratio, low, high = stats.ratio_interval(2 * a, a)
    assert ratio == low == high == 2
    ratio, low, high = stats.ratio_interval(a[::-1], a)
    assert low < ratio == 1 < high
    assert stats.wilcoxon(a, a + 1) == pytest.approx(2**-9)
    assert stats.wilcoxon(a, a) == 1
    assert stats.wilcoxon([1, 2, 3, 4, 5], [2, 4, 6, 8, 10]) == 0.0625
    assert stats.mean_text([1.0, np.nan]) == "–"


def test_the_page_escapes_what_it_is_given(tmp_path):
    from wakefold.experiments.page import page

    section = Section("<b>", ["a < b"], claims=[Claim("x", "y", "z & w", verdict="does not hold")])
    text = page([section], TINY, 60.0)
    assert "&lt;b&gt;" in text
    assert "a &lt; b" in text
    assert 'class="does"' in text


def test_the_command(tmp_path, monkeypatch):
    run = CliRunner().invoke(app, ["reproduce", "--list"])
    assert run.exit_code == 0
    assert "fig7a" in run.output
    assert CliRunner().invoke(app, ["reproduce", "fig99"]).exit_code == 2
    (tmp_path / "file").write_text("")
    assert CliRunner().invoke(app, ["reproduce", "--out", str(tmp_path / "file")]).exit_code == 2
    run = CliRunner().invoke(app, ["reproduce", "fig3", "--quick", "--out", str(tmp_path / "page")])
    assert run.exit_code == 0, run.output
    assert (tmp_path / "page" / "index.html").exists()


def test_naming_the_figures_is_light():
    code = "import sys, wakefold.experiments.registry; print([m for m in ('numpy', 'matplotlib') if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_a_job_says_how_dear_it_is():
    jobs = experiment("mse").jobs(registry.FULL)
    assert all(isinstance(job, Job) and job.cost > 0 for job in jobs)
