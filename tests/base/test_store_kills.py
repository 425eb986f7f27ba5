"""A save that is killed anywhere leaves the old store or the new one; readers meanwhile never fail."""

import json
import shutil
import subprocess
import sys

import pytest

KILLER = """
import json, os, random, signal, sys, time
import numpy as np
from wakefold.base import store

folder, mode, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
path = os.path.join(folder, "model")
BIG = 20_000


def save(version):
    store.save(path, {"x": np.full(BIG, version), "y": np.arange(version % 5)}, {"version": version}, "thing")


def version():
    arrays, meta = store.load(path, "thing")
    assert (arrays["x"] == meta["version"]).all() and len(arrays["y"]) == meta["version"] % 5
    return meta["version"]


def child_at_line(nth, new):
    seen = 0

    def trace(frame, event, arg):
        nonlocal seen
        if not frame.f_code.co_filename.endswith(("store.py", "tempfile.py", "shutil.py", "pathlib.py")):
            return None
        if event == "line":
            seen += 1
            if seen == nth:
                os.kill(os.getpid(), signal.SIGKILL)
        return trace

    sys.settrace(trace)
    save(new)
    os._exit(0)


def check(old, news):
    found = version()
    assert found in (old, *news), (found, old, news)
    return found


done, lost, killed = 0, 0, 0
if mode != "first":
    save(0)
n = 0
while True:
    n += 1
    old = version() if mode != "first" else None
    if mode == "first":
        import shutil
        shutil.rmtree(path, ignore_errors=True)
    new = n
    child = os.fork()
    if child == 0:
        try:
            if mode == "random":
                for step in range(1000):
                    save(1000 * n + step)
            child_at_line(n, new)
        finally:
            os._exit(3)
    if mode == "random":
        time.sleep(random.Random(n).uniform(0, 0.02))
        os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    ended = not os.WIFSIGNALED(status)
    killed += not ended
    if mode == "first":
        if os.path.exists(path):
            assert version() == new
    elif mode == "random":
        found = version()
        assert found == old or found // 1000 == n, (found, old)
    else:
        check(old, [new])
    if n % 7 == 0 or ended:  # what was left behind is cleaned by the next save
        save(n + 10_000_000)
        assert os.listdir(folder) == ["model"], os.listdir(folder)
        entries = json.load(open(path + "/manifest.json"))["arrays"]
        named = {entry.get("file", name + ".npy") for name, entry in entries.items()}
        assert set(os.listdir(path)) == named | {"manifest.json"}
    if ended or n >= count:
        break
print(json.dumps({"tries": n, "killed": killed, "ended": ended}))
"""

BOUNDARIES = """
import json, os, signal, subprocess, sys, time
import numpy as np
from wakefold.base import store

folder, calls = sys.argv[1], sys.argv[2].split(",")
path = os.path.join(folder, "model")


def save(version):
    store.save(path, {"x": np.full(20_000, version), "y": np.arange(version % 5)}, {"version": version}, "thing")


def version():
    arrays, meta = store.load(path, "thing")
    assert (arrays["x"] == meta["version"]).all() and len(arrays["y"]) == meta["version"] % 5
    return meta["version"]


save(0)
kills = {}
for call in calls:
    for nth in range(1, 1000):
        old, new = version(), version() + 1
        child = os.fork()
        if child == 0:
            os.kill(os.getpid(), signal.SIGSTOP)
            save(new)
            os._exit(0)
        os.waitpid(child, os.WUNTRACED)
        inject = ["-e", f"trace={call}", "-e", f"inject={call}:signal=KILL:when={nth}"]
        tracer = subprocess.Popen(["strace", "-qq", "-o", "/dev/null", *inject, "-p", str(child)])
        while f"TracerPid:\\t{tracer.pid}" not in open(f"/proc/{child}/status").read():
            if tracer.poll() is not None:
                os.kill(child, signal.SIGKILL)
                sys.exit(print("{}"))
            time.sleep(0.001)
        os.kill(child, signal.SIGCONT)
        status = os.waitpid(child, 0)[1]
        tracer.wait()
        ended = not os.WIFSIGNALED(status)
        assert version() in ((new,) if ended else (old, new)), (call, nth)
        if ended:
            break
    kills[call] = nth - 1
    assert os.listdir(folder) == ["model"], os.listdir(folder)
print(json.dumps(kills))
"""

READER = """
import os, sys, time
import numpy as np
from wakefold.base import store

path = sys.argv[1] + "/model"
store.save(path, {"x": np.zeros(1000)}, {"version": 0}, "thing")
child = os.fork()
if child == 0:
    for k in range(1, 150):
        store.save(path, {"x": np.full(1000, k)}, {"version": k}, "thing")
    os._exit(0)
reads = 0
while os.waitpid(child, os.WNOHANG) == (0, 0):
    arrays, meta = store.load(path, "thing")
    assert (arrays["x"] == meta["version"]).all()
    reads += 1
print(reads, store.load(path, "thing")[1]["version"])
"""


def run(script, *arguments):
    done = subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("mode", ["replace", "first"])
def test_killed_at_every_line(tmp_path, mode):
    found = json.loads(run(KILLER, tmp_path, mode, 5000))
    assert found["ended"]  # the last try was not killed any more: every line was
    assert found["killed"] > 50


def test_killed_at_any_time(tmp_path):
    assert json.loads(run(KILLER, tmp_path, "random", 300))["killed"] == 300


@pytest.mark.skipif(shutil.which("strace") is None, reason="needs strace")
def test_killed_at_every_system_call(tmp_path):
    """Killed on entering the first, second, ... call of each kind that a save makes, until one is not made again."""
    changes = ["openat", "write", "close", "fsync", "mkdir", "rename", "renameat2", "unlink", "unlinkat", "rmdir"]
    kills = json.loads(run(BOUNDARIES, tmp_path, ",".join(changes)))
    if not kills:
        pytest.skip("strace may not trace here")
    assert kills["fsync"] > 2
    assert kills["write"] > 2
    assert sum(kills.values()) > 30


def test_readers_never_fail_meanwhile(tmp_path):
    reads, last = map(int, run(READER, tmp_path).split())
    assert reads > 10
    assert last == 149
