"""All benchmarks, one after the other: ``python -m benchmarks [--quick]``."""

import sys

from benchmarks import demo_settings, engines, filters, filtration, fleet, frechet, growth, hostile, reading, relational

for script in (frechet, filtration, growth, filters, fleet, relational, engines, reading, hostile, demo_settings):
    print(f"\n## {script.__name__}\n")
    script.main(quick="--quick" in sys.argv[1:])
