"""Table 2 of the paper: reward by target pushes spent, on the Heavy stand-in whose mass and inertia
no parameter models.

    python experiments/table1_pushing.py --out OUT --seeds 3 --settings wd --target drake \\
        --bottle heavy --iterations 12 \\
        --methods adaptsim learn_in_target --no-oracle
    # prints the table, draws OUT/data_budget.png
    python experiments/table2_pushing.py OUT

AdaptSim makes 4 pushes an iteration (two starts, two pushes each): what it deploys after 4 i pushes
is the policy of iteration i. Two rows of it: the mean of its two starts, which anyone could have,
and the better of them as the test goals tell, as in Table 1. With `--starts 1 --methods adaptsim`
in another folder, given here as a second one, the same pushes go to one start.
"""

import argparse
from pathlib import Path

import numpy as np

BUDGETS = (0, 4, 8, 16, 24, 32, 40, 48)
NAMES = {
    "adaptsim": "AdaptSim",
    "learn_in_target": "LearnInTarget",
    "udr_target": "UDR+Target",
    "bayesopt": "BayesOpt",
}


def rows_of(out: Path) -> dict[str, np.ndarray]:
    """Rewards `[S, 8]` at `BUDGETS` of each row, not a number where a method has none."""
    rows = {}
    for method, name in NAMES.items():
        parts = [np.load(path) for path in sorted(out.glob(f"{method}-seed*.npz"))]
        if not parts:
            continue
        rewards = np.concatenate([part["rewards"] for part in parts], 1)[0]  # [S, N, I + 1]
        if method == "adaptsim":
            before = (
                parts[0]["spent"] - parts[0]["spent"][0]
            )  # a policy is deployed before its own visit
            if rewards.shape[1] == 1:
                rows[f"{name}, one start"] = at_budgets(before, rewards[:, 0])
                continue
            rows[f"{name}, mean of two starts"] = at_budgets(before, rewards.mean(1))
            rows[f"{name}, better of two starts"] = at_budgets(before, rewards.max(1))
        else:
            spent = parts[0]["spent"]
            best = (
                np.maximum.accumulate(rewards.max(1), -1)
                if method == "bayesopt"
                else rewards.max(1)
            )
            rows[name] = at_budgets(spent, best)
    return rows


def at_budgets(spent: np.ndarray, rewards: np.ndarray) -> np.ndarray:
    """`[S, 8]` of `rewards [S, I + 1]` after `spent [I + 1]` pushes."""
    found = np.full((len(rewards), len(BUDGETS)), np.nan)
    for k, budget in enumerate(BUDGETS):
        where = np.flatnonzero(spent == budget)
        if len(where):
            found[:, k] = rewards[:, where[0]]
    return found


def differences(rows: dict[str, np.ndarray], budget: int = 16) -> list[str]:
    """AdaptSim's first row after `budget` pushes less LearnInTarget after each budget: mean and 95
    % bootstrap interval over seeds.
    """
    ours, theirs = (
        next((v for n, v in rows.items() if n.startswith(name)), None)
        for name in ("AdaptSim", "LearnInTarget")
    )
    if ours is None or theirs is None:
        return []
    lines, seeds = [], min(len(ours), len(theirs))
    draws = np.random.default_rng(0).integers(0, seeds, (4000, seeds))
    for k, after in enumerate(BUDGETS):
        gap = ours[:seeds, BUDGETS.index(budget)] - theirs[:seeds, k]
        if np.isfinite(gap).all():
            low, high = np.quantile(gap[draws].mean(1), [0.025, 0.975])
            above = f"above in {np.sum(gap > 0)} of {seeds}"
            lines.append(
                f"AdaptSim after {budget} less LearnInTarget after {after}: {gap.mean():.3f} "
                f"({low:.3f}..{high:.3f}), {above}"
            )
    return lines


def table(rows: dict[str, np.ndarray]) -> str:
    """Mean over seeds and, behind it, the least and the most."""
    lines = [
        "| pushes | " + " | ".join(map(str, BUDGETS)) + " |",
        "| --- " * (len(BUDGETS) + 1) + "|",
    ]
    for name, values in rows.items():

        def cell(v):
            return "" if np.isnan(v).any() else f"{v.mean():.3f} ({v.min():.2f}-{v.max():.2f})"

        lines.append(f"| {name} | " + " | ".join(map(cell, values.T)) + " |")
    return "\n".join(lines)


def draw(rows: dict[str, np.ndarray], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    for name, values in rows.items():
        have = ~np.isnan(values).any(0)
        x, y = np.array(BUDGETS)[have], values[:, have]
        (line,) = axes.plot(x, y.mean(0), marker="o", ms=4, label=name)
        axes.fill_between(x, y.min(0), y.max(0), color=line.get_color(), alpha=0.15, lw=0)
    axes.set(
        xlabel="pushes made in the target", ylabel="reward (1 - distance / 0.2 m)", xticks=BUDGETS
    )
    axes.legend(frameon=False, loc="lower right")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "out",
        type=Path,
        nargs="+",
        help="folders of table1_pushing.py; the figure goes to the first",
    )
    args = parser.parse_args()
    rows = {name: values for folder in args.out for name, values in rows_of(folder).items()}
    if not rows:
        raise SystemExit(
            f"{args.out[0]}: no results there; run experiments/table1_pushing.py first"
        )
    print("\n".join([table(rows), *differences(rows)]))
    draw(rows, args.out[0] / "data_budget.png")


if __name__ == "__main__":
    main()
