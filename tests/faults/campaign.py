"""Damaged recordings of one reader, as many as asked for: what was refused, and what was wrong.

python -m tests.faults.campaign FOLDER "mechanism, LeRobot" 10000 [FIRST SEED] [SECONDS AT MOST]
"""

import sys
import time
from pathlib import Path

import numpy as np

from tests.faults.test_damage_campaign import ALL, wrong

if __name__ == "__main__":
    np.seterr(all="ignore")
    folder, name, count, *more = sys.argv[1:]
    (reader,) = [r for r in ALL if r.name == name]
    first, longest = int(more[0]) if more else 0, float(more[1]) if len(more) > 1 else np.inf
    Path(folder).mkdir(parents=True, exist_ok=True)
    begin, refused, bad, done = time.monotonic(), 0, [], 0
    for seed in range(first, first + int(count)):
        if time.monotonic() - begin > longest:
            break
        was, why = wrong(reader, seed, Path(folder) / "data")
        refused, done = refused + was, done + 1
        if why:
            bad.append((seed, why))
            print(seed, why, flush=True)
    print(
        f"{name}: {done} cases from seed {first}, {refused} refused, {len(bad)} wrong", flush=True
    )
    sys.exit(bool(bad))
