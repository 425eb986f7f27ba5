"""Pedestrian scenes with groups: how they are read, and what is refused."""

import numpy as np
import pytest

from wakefold.experiments.walking.pedestrians import read_scene


def write(folder, rows, groups):
    lines = (f"  {frame:.7e}   {who:.7e}   {x:.7e}   0.0   {y:.7e}   0   0   0" for frame, who, x, y in rows)
    (folder / "obsmat.txt").write_text("\n".join(lines) + "\n")
    (folder / "groups.txt").write_text(groups)
    return folder


def test_people_and_groups(tmp_path):
    rows = [(f, who, f + who, -f) for who in (3, 1, 20) for f in (1, 11, 21)]
    scene = read_scene(write(tmp_path, rows, "3\n 20 1 \n\n1 3\n"), "somewhere")  # students03 begins with a count
    assert scene.name == "somewhere"
    assert scene.tracks.ids.tolist() == ["1", "3", "20"]
    assert np.allclose(scene.tracks.times[:3], [0.0, 0.4, 0.8])
    assert np.array_equal(scene.tracks.points[:2], [[2.0, -1.0], [12.0, -11.0]])
    assert scene.groups == (("20", "1"), ("1", "3"))
    assert scene.partners() == {("1", "20"), ("1", "3")}  # in the order of the tracks


def test_frames_are_taken_down_so_a_shift_does_not_break_the_clock(tmp_path):
    rows = [(f, 1, 0, 0) for f in (6, 12, 18)] + [(f, 2, 1, 1) for f in (15, 21, 27)] + [(f, 3, 2, 2) for f in (17, 23)]
    scene = read_scene(write(tmp_path, rows, "1 2\n"))
    assert [scene.tracks.times[a] for a in scene.tracks.offsets[:-1]] == pytest.approx([0.0, 0.4, 0.4])


def test_overlapping_groups_give_each_pair_once(tmp_path):
    rows = [(f, who, 0, 0) for who in (1, 2, 3) for f in (0, 10)]
    scene = read_scene(write(tmp_path, rows, "1 2 2\n2 1 3\n9 1\n"))
    assert scene.partners() == {("1", "2"), ("1", "3"), ("2", "3")}


@pytest.mark.parametrize(
    ("rows", "groups", "message"),
    [
        ([(0, 1, 0, 0), (0, 1, 1, 1)], "1 2\n", "1 is in two places in frame 0"),
        ([(0, 1, 0, np.nan)], "1 2\n", "obsmat.txt line 1"),
        ([(0, 1, 0, 0)], "1 2\n1 x\n", "groups.txt line 2"),
        ([(0, 1, 0, 0)], "1 2.5\n", "groups.txt line 1"),
        ([(0, 1, 0, 0)], "\n", "groups.txt is empty"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, rows, groups, message):
    with pytest.raises(ValueError, match=message):
        read_scene(write(tmp_path, rows, groups))
