"""The harness of the experiments: observations, truth left out, scores, and results kept on disk."""

import json
import math

import numpy as np
import pytest
from bounds import fewest

from wakefold.base.parallel import Processes, Threads
from wakefold.experiments import runner
from wakefold.experiments.mhpf import datasets, fig9, rasters, simulate
from wakefold.experiments.mhpf.grid import LOG
from wakefold.experiments.mhpf.scenarios import Namer, Scenario, Setting, chosen, data, tree_of
from wakefold.experiments.registry import Job, Size

TINY = Size(scenarios=2, repetitions=2, tanker_scenarios=1)
OUT = Setting("common", "out", 0.3, 0.05, coarse=0.5)


def test_the_truth_is_in_no_model_or_in_all_of_it():
    out, inside = Scenario(OUT, 4), Scenario(OUT._replace(truth="in"), 4)
    assert len(out.model.tracks) == 12
    assert not (out.model.dynamics.points[:, None] == data("common")[4][5:-5]).all(axis=2).any()
    assert len(inside.model.tracks) == 13
    assert inside.away.min() == inside.away[4] == 0
    assert out.away.min() == out.tree.death[4]
    assert out.reach == out.tree.birth.max()


def test_observations_are_those_of_section_4():
    scenario = Scenario(OUT, 2)
    seen = scenario.observations(0, 1)
    assert len(seen) == len(scenario.path) - 1
    offsets = np.array([o.fix for o in seen]) - scenario.path[1:]
    assert offsets.min() >= 0
    assert offsets.max() <= OUT.psi * scenario.diagonal
    assert offsets.max() > 0.9 * OUT.psi * scenario.diagonal
    many = [o.report is not None for r in range(4) for o in scenario.observations(0, r)]
    assert 0.38 < np.mean(many) < 0.62  # 264 with probability .5: 3.9 sd; a share of .75 is 4.8 sd beyond
    again = scenario.observations(0, 1)
    assert all(np.array_equal(a.fix, b.fix) and a.report == b.report for a, b in zip(seen, again, strict=True))
    other = Scenario(OUT._replace(kappa=0.75, psi=0.01), 2).observations(0, 1)
    small = np.array([o.fix for o in other]) - scenario.path[1:]
    assert np.allclose(5 * small, offsets)  # the same numbers at another scale
    assert not np.array_equal(seen[0].fix, scenario.observations(0, 2)[0].fix)


def test_after_the_lead_in_there_are_reports_only():
    scenario = Scenario(OUT._replace(lead_in=0.1, coarse=1.0), 2)
    seen = scenario.observations(0, 0)
    fixes = [o.fix is not None for o in seen]
    assert fixes == sorted(fixes, reverse=True)
    assert sum(fixes) == int(0.1 * len(seen))
    assert [o.report is None for o in seen] == fixes


def test_a_share_of_the_reports_is_wrong():
    right, wrong = (
        [o.report for r in range(12) for o in Scenario(OUT._replace(wrong=w), 2).observations(0, r) if o.report]
        for w in (0.0, 0.3)
    )
    different = np.mean([a != b for a, b in zip(right, wrong, strict=True)])
    assert 0.2 < different < 0.4  # of some 396: 4.3 sd; with none, or half of them wrong, 4 sd beyond


def test_reports_name_the_class_of_the_definition():
    """But for the points left out: only ``NEAREST`` around each sample count, by which 1 in 80 is named otherwise."""
    tracks, tree = tree_of("common", "single", 3)
    namer, rng, alike = Namer(tracks, tree), np.random.default_rng(1), 0
    for _ in range(60):
        at = tracks.points[rng.integers(len(tracks.points))]
        samples = at + rng.normal(scale=0.05, size=(10, 2))
        best, most = -1, -math.inf
        for c in range(len(tree), tree.root):
            members = tree.members(c)
            points = np.concatenate([tracks[i] for i in members])
            total = 0.0
            for sample in samples:
                near = np.sort(np.linalg.norm(points - sample, axis=1))[: len(members)]
                total += -math.log(min(max(near.mean() / tracks.diagonal, 1e-4), 1.0))
            if total > most:
                best, most = c, total
        alike += int(namer.classes(samples[None])[0]) == best
        assert namer.another(best, 5) != best
    assert alike >= fewest(60, 0.96)  # one who names another class in one of three fails with probability .997


def test_a_report_is_read_at_the_middle_of_the_life_of_its_class():
    scenario = Scenario(OUT, 3)
    tree = scenario.model.filtration
    for c in range(len(tree), tree.root):
        assert scenario.report(c) == (c, (tree.birth[c] + tree.death[c]) / 2)


@pytest.mark.parametrize("truth", range(13))
def test_reports_named_among_all_tracks_keep_their_other_tracks(truth):
    scenario = Scenario(OUT._replace(told_by="all"), truth)
    everybody, tree = scenario.tree, scenario.model.filtration
    assert scenario.namer.tree is everybody
    for c in range(len(everybody), everybody.root):
        others = set(everybody.members(c).tolist()) - {truth}
        holding = [k for k in range(len(tree), tree.root) if others <= set(scenario.kept[tree.members(k)].tolist())]
        report = scenario.report(c)
        if not holding:
            assert report is None
        else:
            least = min(holding, key=lambda k: len(tree.members(k)))
            assert report == (least, (tree.birth[least] + tree.death[least]) / 2)
    seen = scenario.observations(0, 0)
    assert any(o.report for o in seen)


def test_arrival_is_the_end_of_the_last_stay_outside():
    assert simulate.arrival(np.zeros(10), 0.3) == 0
    assert simulate.arrival(np.ones(10), 0.3) == 1
    assert simulate.arrival(np.array([1.0] * 5 + [0.0] * 15), 0.3) == 0.4  # of 5 and more the mean is .2 from 8 on
    assert simulate.arrival(np.array([0.0] * 19 + [2.0]), 0.3) == 1


def test_scores_are_those_of_runs_by_hand():
    method = simulate.Method("mhpf", "log", "gsi2017")
    job = simulate.job(OUT, method, TINY)
    assert json.loads(json.dumps(job.spec)) == job.spec
    found = simulate.scores(simulate.run(dict(job.spec)))
    truth = chosen("common", 2, 0)[1]
    scenario = Scenario(OUT, truth)
    f = simulate.make(method, scenario.model, 100, 0)
    belief, squares, away = f.start(at="begin", agent=f"{truth}/1"), [], []
    for observed, at in zip(scenario.observations(0, 1), scenario.path[1:], strict=True):
        belief = f.step(belief, simulate.evidence(observed), dt=1.0)
        squares.append(((belief.mean() - at) ** 2).sum())
        track = scenario.kept[belief.map()]
        away.append(scenario.tree.tree_distance(int(track), truth))
    assert found.mse[1, 1] == pytest.approx(np.mean(squares))
    assert found.distance[1, 1] == pytest.approx(np.mean(away))
    assert found.excess[1, 1] == pytest.approx(np.mean(away) - scenario.tree.death[truth])


def test_with_fixes_alone_gsi2017_is_bl1():
    setting = Setting("common", "out", 0.05, 0.05)
    runs = [simulate.run(dict(simulate.job(setting, m, TINY).spec)) for m in LOG]
    mhpf, bl1, coarse = (simulate.scores(runs[k]) for k in (1, 2, 3))
    assert np.allclose(mhpf.mse, bl1.mse)
    assert np.array_equal(bl1.mse, coarse.mse)
    assert np.isnan(simulate.scores(runs[4]).distance).all()  # BL2 tells no classes apart


def test_results_are_kept_and_an_interrupted_run_goes_on(tmp_path, monkeypatch):
    jobs = [simulate.job(OUT, method, TINY) for method in LOG[:3]]
    seen = []
    first = runner.run_all([*jobs, jobs[0]], tmp_path, Threads(1), seen.append)
    each = [runner.seconds([job], tmp_path) for job in jobs]
    assert min(each) > 0
    assert runner.seconds([*jobs, jobs[0]], tmp_path) == pytest.approx(sum(each))
    assert first[0] == first[3]
    assert len(list(tmp_path.iterdir())) == 3
    assert seen[-1] == 1
    kept = runner.key(jobs[1])
    (tmp_path / f"{kept}.json").unlink()
    ran = []
    monkeypatch.setattr(simulate, "run", lambda spec: ran.append(spec) or {"again": True})
    second = runner.run_all(jobs, tmp_path, Threads(1))
    assert len(ran) == 1
    assert second == [first[0], {"again": True}, first[2]]


def test_results_hang_on_the_code_and_on_all_of_the_specification(monkeypatch):
    one, other = (Job("mhpf.simulate:run", {"seed": seed}) for seed in (0, 1))
    assert runner.key(one) != runner.key(other)
    assert runner.key(one) == runner.key(Job("mhpf.simulate:run", {"seed": 0}, cost=9.0))
    assert runner.code_digest("mhpf.simulate") != runner.code_digest("mhpf.scenarios")
    before = runner.key(one)
    monkeypatch.setattr(runner, "code_digest", lambda module: "other code")
    assert runner.key(one) != before


def test_the_code_a_result_hangs_on_is_what_its_module_imports(tmp_path, monkeypatch):
    (tmp_path / "experiments").mkdir()
    files = {"experiments/one.py": "from wakefold.part import x", "part.py": "import wakefold.deep", "deep.py": "x = 1"}
    files["__init__.py"] = "from wakefold.apart import y"  # what the package offers, no result hangs on
    for name, text in {**files, "apart.py": "y = 1"}.items():
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(runner, "SOURCE", tmp_path)
    fresh = runner.code_digest.__wrapped__
    before = fresh("one")
    (tmp_path / "apart.py").write_text("y = 2")
    assert fresh("one") == before
    (tmp_path / "deep.py").write_text("x = 2")
    assert fresh("one") != before


def test_processes_give_what_threads_give(tmp_path):
    jobs = [simulate.job(OUT, method, TINY) for method in LOG[2:4]]
    one = runner.run_all(jobs, tmp_path / "threads", Threads(1))
    assert runner.run_all(jobs, tmp_path / "processes", Processes(2)) == one


def test_the_raster_of_a_file_stands_in_for_the_synthetic_one(tmp_path):
    rows = ["agent,time,lon,lat"]
    for k in range(24):
        for i in range(60):
            lon, lat = -90 + 0.05 * i, 27 + (0.03 * i if k % 2 else 1.0) + 0.01 * (k // 2)
            rows.append(f"{k},2024-01-01T{i // 6:02}:{i % 6}0:00Z,{lon:.4f},{lat:.4f}")
    (tmp_path / "ships.csv").write_text("\n".join(rows))
    name = rasters.keep(tmp_path / "ships.csv", tmp_path / "out")
    raster, starts = rasters.traffic(name)
    assert len(starts) == 9
    assert np.array_equal(tree_of(name, "single", None)[0].points, datasets.walks(raster, starts).points)
    assert len(data(name)) == 194
    assert chosen(name, 5, 0) == chosen("tankers", 5, 0)
    assert {job.spec["setting"]["data"] for job in fig9.jobs(TINY._replace(tankers=name))} == {name}
    assert rasters.keep(tmp_path / "ships.csv", tmp_path / "out") == name


def test_calibrated_is_not_run_again_for_another_noise_of_the_model():
    loud, method = OUT._replace(kappa=0.75), simulate.Method("calibrated", "gaussian")
    assert runner.key(simulate.job(OUT, method, TINY)) == runner.key(simulate.job(loud, method, TINY))
    quiet = simulate.run(dict(simulate.job(OUT, method, TINY).spec))
    spec = dict(simulate.job(OUT, method, TINY).spec)
    assert simulate.run(spec | {"setting": loud._asdict()}) == quiet


def test_observations_depend_on_nothing_that_is_left_out_when_they_are_kept():
    for setting in (OUT._replace(kappa=0.75), OUT._replace(epsilon="wide"), OUT._replace(wrong=0.3)):
        kept = simulate._observed(simulate._seen(setting), 2, 0, 1)
        for seen, made in zip(kept, Scenario(setting, 2).observations(0, 1), strict=True):
            assert np.array_equal(seen.fix, made.fix)
            assert seen.report == made.report
