"""`make fuzz`: damages every kind of input for some minutes; exit code 1 and a list where a reader broke the law."""

from __future__ import annotations

import argparse
import random
import sys
import time
import traceback

from tests.fuzz.fuzzing import fuzz, new_seed
from tests.fuzz.targets import TARGETS

_EXAMPLES = 60


def main() -> int:
    """Go round all targets until the time is over."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument(
        "--seed", type=int, default=None, help="of the first target; default: another each time"
    )
    parser.add_argument("--only", default="", help="targets whose name holds this word")
    words = parser.parse_args()
    draw = random.Random(words.seed)
    targets = {name: target for name, target in TARGETS.items() if words.only in name}
    end = time.monotonic() + 60.0 * words.minutes
    found, rounds = 0, 0
    while time.monotonic() < end and targets:
        for name, target in targets.items():
            if time.monotonic() >= end:
                break
            first_seed = new_seed(draw)
            rounds += 1
            try:
                fuzz(target, _EXAMPLES, first_seed)
            except BaseException as err:
                if isinstance(err, KeyboardInterrupt):
                    raise
                found += 1
                print(f"--- {name}, seed {first_seed}", flush=True)
                traceback.print_exception(err, limit=-6, chain=False)
                print("\n".join(getattr(err, "__notes__", [])), flush=True)
    print(f"{rounds * _EXAMPLES} damages of {len(targets)} kinds of input, {found} findings", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
