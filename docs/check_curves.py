"""Whether runs' curves are what measures.md says: how many rows, a clock that only goes forwards, what measuring took.

    python docs/check_curves.py RUN_DIR [RUN_DIR ...]

Exits with 1 if a curve has fewer than eight rows, its clock goes back, or measuring took a tenth of the wall time.
"""

import json
import sys
from itertools import pairwise
from pathlib import Path

from sculpt_framework.evaluation.curve import read_curve
from sculpt_framework.evaluation.report import seconds_spent

ROWS_AT_LEAST = 8
MEASURING_UNDER = 0.10


def main() -> int:
    broken = 0
    sys.stdout.write(
        f"{'run':40} {'rows':>5} {'clock':>9} {'measuring':>10} {'seconds':>8} {'Chamfer':>9} {'PSNR':>6}\n"
    )
    for name in sys.argv[1:]:
        curve = read_curve(Path(name) / "curve.csv")
        lines = (Path(name) / "events.jsonl").read_text(encoding="utf-8").splitlines()
        spent = seconds_spent([json.loads(line) for line in lines])
        times = [row["t_train_s"] or 0.0 for row in curve]
        forwards = all(before <= after for before, after in pairwise(times))
        share, final = spent["measuring"] / sum(spent.values()), curve[-1]
        broken += len(curve) < ROWS_AT_LEAST or not forwards or share >= MEASURING_UNDER
        chamfer, psnr = (final[column] or float("nan") for column in ("chamfer_ps", "psnr"))
        sys.stdout.write(
            f"{name[-40:]:40} {len(curve):5} {'forwards' if forwards else 'back':>9} {share:10.1%} "
            f"{sum(spent.values()):8.0f} {chamfer:9.5f} {psnr:6.2f}\n"
        )
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
