"""The table that holds AdaptSim against each method over seeds."""

import json

import numpy as np

from experiments.return_against_trials import TASKS, against, rows


def test_each_method_is_held_against_adaptsim_in_each_target_over_seeds(tmp_path):
    names = list(TASKS["pendulum"]["targets"])
    rng, folder = np.random.default_rng(0), tmp_path / "pendulum"
    folder.mkdir()
    for seed in range(6):
        own = rng.normal(0.0, 1.0, len(names))

        def luck(size):
            return rng.normal(0.0, size, len(names))

        def of(after, other=0.0):
            return [[other, float(x)] for x in after]

        found = {
            "adaptsim": {"trials": [1, 10], "returns": of(own, -9.0)},
            "udr": {"trials": [0], "returns": [[float(x - 5.0)] for x in own]},
            "bayesopt": {
                "trials": [10, 40],
                "returns": [[float(x), 99.0] for x in own + luck(0.1)],
            },
            "cma_es": {"trials": [4, 8], "returns": of(own + 3.0 + luck(0.1))},
        }
        (folder / f"seed-{seed}.json").write_text(json.dumps(found))
    rows = {
        line.split(" | ")[0][2:]: line.split(" | ")[1:]
        for line in against(tmp_path)
        if line.startswith("| ")
    }
    assert (
        rows["UDR"][0] == "6"
        and all(cell.startswith("5 +") for cell in rows["UDR"][1:-2])
        and rows["UDR"][-2:] == ["4", "4 |"]
    )
    assert rows["BayesOpt"][-1] == "4 |" and all(
        abs(float(cell.split()[0])) < 0.3 for cell in rows["BayesOpt"][1:-2]
    )
    assert rows["CMA-ES"][-2:] == ["0", "0 |"] and all(
        cell.endswith(" -") for cell in rows["CMA-ES"][1:-2]
    )


def test_nothing_is_said_of_more_trials_than_any_method_made(tmp_path):
    folder, flat = (
        tmp_path / "pendulum",
        lambda x, n: [[x] * n for _ in TASKS["pendulum"]["targets"]],
    )
    folder.mkdir()
    found = {
        "udr": {"trials": [0], "returns": flat(1.0, 1)},
        "oracle": {"trials": [0], "returns": flat(2.0, 1)},
        "cma_es": {"trials": [4, 8], "returns": flat(1.5, 2)},
        "adaptsim": {"trials": [5, 11], "returns": flat(1.2, 2)},
    }
    (folder / "seed-0.json").write_text(json.dumps(found))
    table = rows(tmp_path)
    assert {r["budget"] for r in table if r["method"] == "udr"} == {0, 2, 5, 10}
    at = {
        r["budget"]: r["mean"] for r in table if (r["method"], r["target"]) == ("cma_es", "heavy")
    }
    assert at == {5: 0.5, 10: 0.5}
