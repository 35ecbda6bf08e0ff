"""A fit to many long tumbling records, begun far off: 10 Hz over 2000 s, the inertia ratio 20 % wrong.

    python -m docs.long_records -o fits/long-records [--records 100]

The records are torque-free motion in closed form with noise, in memory. Writes `result.json`: estimate, its standard
deviation, the truth, seconds, and the largest memory that the process took.
"""

import argparse
import resource
import time
from pathlib import Path

from ddetumble import fit
from ddetumble.inference.files import list_versions, write_json
from tests.helpers_tumble import make_long


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--off", type=float, default=0.2, help="share by which the start is wrong")
    given = parser.parse_args()
    truth = 0.55
    campaign = make_long(given.records, 2000.0, 0.1, truth)
    begun = time.perf_counter()
    found = fit(campaign, start={"inertia_ratio": truth * (1.0 + given.off)})
    seconds = time.perf_counter() - begun
    ratio = found.parameters["inertia_ratio"]
    result = {"records": given.records, "samples": 20_001, "start": truth * (1.0 + given.off), "truth": truth,
              "estimate": ratio.estimate, "sd": ratio.sd, "converged": found.converged,
              "chi2_reduced": found.chi2_reduced, "seconds": seconds,
              "largest_memory_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2,
              "versions": list_versions()}
    given.output.mkdir(parents=True, exist_ok=True)
    write_json(given.output / "result.json", result)
    print(result)


if __name__ == "__main__":
    main()
