"""Reading a MarineCadastre CSV beside DuckDB parsing and aggregating the same columns.

``python -m benchmarks.reading --rows 10000000`` writes a seeded file of that many rows into a temporary directory
(about 115 bytes a row) and runs each reader in a process of its own, in turn, with two threads. DuckDB is looked for
in the interpreter named by ``--peer`` (this one by default). Wall and CPU seconds exclude starting Python and imports;
the peak resident set is that of the whole process.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

BLOCK = 500_000
COLUMNS = ("MMSI", "BaseDateTime", "LAT", "LON", "SOG", "COG", "Heading")
ATTRIBUTES = ("VesselName", "CallSign", "VesselType", "Length", "Width")

OURS = """
import sys, time, json, resource
import pyarrow.csv, pyproj, scipy.sparse
import wakefold as wf
wall, cpu = time.perf_counter(), time.process_time()
tracks, report = wf.read_tracks(sys.argv[1])
wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
print(json.dumps({"wall": wall, "cpu": cpu, "peak": peak, "rows": report.rows, "groups": len(tracks)}))
"""

PEER = """
import sys, time, json, resource
import duckdb
connection = duckdb.connect(config={"threads": 2})
connection.execute("SET enable_progress_bar = false")
query = f'''SELECT MMSI, count(*) AS n, min(BaseDateTime), max(BaseDateTime), avg(LAT), avg(LON), avg(SOG), avg(COG),
    avg(Heading), last(VesselName), last(CallSign), last(VesselType), last(Length), last(Width)
    FROM read_csv('{sys.argv[1]}') GROUP BY MMSI'''
wall, cpu = time.perf_counter(), time.process_time()
groups = connection.execute(query).fetchall()
wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
print(json.dumps({"wall": wall, "cpu": cpu, "peak": peak, "rows": sum(g[1] for g in groups), "groups": len(groups)}))
"""


def write_marinecadastre(path: Path, rows: int, seed: int = 0) -> None:
    """A day of ``rows`` reports of ``rows / 500`` ships off the coasts of the United States, in order of time.

    Ships move on smooth closed courses; one report in 2,000 has no position, one in 50 no heading, one in 20 no name.
    """
    import pyarrow as pa
    import pyarrow.csv

    random = np.random.default_rng(seed)
    ships = max(rows // 500, 1)
    mmsi = random.choice(9_000_000, ships, replace=False) + 366_000_000
    lat0, lon0 = random.uniform(25, 48, ships), random.uniform(-124, -70, ships)
    reach, period, phase = (
        random.uniform(0, 0.2, ships),
        random.uniform(4, 20, ships) * 3600,
        random.uniform(0, 6, ships),
    )
    names = np.array(
        [f"{a} {b}" for a, b in random.choice(["NORTHERN", "LADY", "CAPT", "MISS", "SEA", "GULF"], (ships, 2))]
    )
    names[random.random(ships) < 0.05] = ""
    static = {
        "VesselName": names,
        "IMO": np.array([f"IMO{7_000_000 + i}" for i in range(ships)]),
        "CallSign": np.array([f"W{c}{i % 10_000:04d}" for i, c in enumerate(random.choice(list("ABCDEXYZ"), ships))]),
        "VesselType": random.choice([30, 31, 37, 52, 60, 70, 80, 90], ships),
        "Status": random.choice([0, 1, 5, 15], ships),
        "Length": random.integers(8, 340, ships),
        "Width": random.integers(3, 50, ships),
        "Draft": np.round(random.uniform(2, 15, ships), 1),
        "Cargo": random.choice([0, 30, 52, 70, 80], ships),
        "TransceiverClass": random.choice(["A", "B"], ships),
    }
    with path.open("wb") as sink:
        for start in range(0, rows, BLOCK):
            row = np.arange(start, min(start + BLOCK, rows))
            ship = (row * 7919 + row // ships) % ships  # every ship once in a cycle of `ships` rows
            seconds = row * 86_400 // rows
            angle = 2 * np.pi * seconds / period[ship] + phase[ship]
            lat, lon = lat0[ship] + reach[ship] * np.sin(angle), lon0[ship] + reach[ship] * np.cos(angle)
            speed = reach[ship] * 2 * np.pi / period[ship] * 216_000  # degrees per second to knots
            lat[random.random(len(row)) < 1 / 2000] = 91.0
            heading = np.where(random.random(len(row)) < 1 / 50, 511.0, np.round(np.degrees(angle) % 360))
            table = {
                "MMSI": mmsi[ship],
                "BaseDateTime": np.datetime_as_string(np.datetime64("2024-01-01", "s") + seconds),
                "LAT": np.round(lat, 5),
                "LON": np.round(lon, 5),
                "SOG": np.round(speed + random.uniform(0, 0.3, len(row)), 1),
                "COG": np.round(np.degrees(angle) % 360, 1),
                "Heading": heading,
                **{name: values[ship] for name, values in static.items()},
            }
            options = pyarrow.csv.WriteOptions(include_header=start == 0, quoting_style="none", quoting_header="none")
            pyarrow.csv.write_csv(pa.table(table), sink, options)


def measure(python: str, code: str, path: Path) -> dict[str, float]:
    """Wall and CPU seconds, peak resident bytes and counts that ``code`` prints when given ``path``."""
    done = subprocess.run([python, "-c", code, str(path)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1])
    return json.loads(done.stdout)


def main(quick: bool = False, rows: int = 10_000_000, repeats: int = 3, peer: str = sys.executable) -> None:
    """Print the table; ``quick`` reads 200,000 rows once."""
    if quick:
        rows, repeats = 200_000, 1
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ais.csv"
        write_marinecadastre(path, rows)
        readers = {"wakefold read_tracks": (sys.executable, OURS), "DuckDB parse and aggregate": (peer, PEER)}
        runs: dict[str, list[dict[str, float]]] = {name: [] for name in readers}
        for _ in range(repeats):
            for name, (python, code) in readers.items():
                runs[name].append(measure(python, code, path))
        print(f"{rows:,} rows, {path.stat().st_size / 1e6:,.0f} MB, median of {repeats}\n")
    print("| reader | wall s | CPU s | peak GiB | rows | groups |\n|---|---|---|---|---|---|")
    for name, results in runs.items():
        middle = {key: statistics.median(r[key] for r in results) for key in results[0]}
        print(
            f"| {name} | {middle['wall']:.2f} | {middle['cpu']:.2f} | {middle['peak'] / 2**30:.2f} "
            f"| {middle['rows']:,.0f} | {middle['groups']:,.0f} |"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rows", type=int, default=10_000_000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--peer", default=sys.executable, help="Python interpreter that has DuckDB")
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    main(arguments.quick, arguments.rows, arguments.repeats, arguments.peer)
