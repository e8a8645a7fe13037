"""Small logs of made-up motion for the tests of the readers."""

from pathlib import Path

import numpy as np

HEAD = 'task = "mechanism"\n'


def motion(n: int, rows: int = 60, dt: float = 0.01) -> dict[str, np.ndarray]:
    """`time [T]` and `q, v, tau [T, n]`, smooth and different for each joint."""
    time = np.arange(rows) * dt
    rate = 2.0 + np.arange(n)
    phase = np.outer(time, rate)
    return {
        "time": time,
        "q": np.sin(phase),
        "v": rate * np.cos(phase),
        "tau": 0.1 * np.cos(phase + 1.0),
    }


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [
        ",".join(columns),
        *(
            ",".join(repr(value) if not isinstance(value, str) else value for value in row)
            for row in rows
        ),
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def numbered(m: dict[str, np.ndarray], *stems: str) -> dict[str, np.ndarray]:
    """Columns `time`, `q1..qn`, ... of a motion."""
    return {"time": m["time"]} | {
        f"{s}{j + 1}": m[s][:, j] for s in stems for j in range(m[s].shape[1])
    }


def named(m: dict[str, np.ndarray], names: tuple[str, ...], *stems: str) -> dict[str, np.ndarray]:
    """Columns `time`, `q_NAME`, ... of a motion."""
    return {"time": m["time"]} | {
        f"{s}_{name}": m[s][:, j] for s in stems for j, name in enumerate(names)
    }


def folder(path: Path, meta: str, **trials: dict[str, np.ndarray]) -> Path:
    """A folder with `meta.toml` and a CSV a trial."""
    path.mkdir(parents=True, exist_ok=True)
    (path / "meta.toml").write_text(HEAD + meta)
    for name, columns in trials.items():
        write_csv(path / f"{name}.csv", columns)
    return path
