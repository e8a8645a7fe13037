"""Pushes and the tracks that a camera saw of them, read from a folder, and the identification problem that they make."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.attribution.trials import Problem
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.sysid.io.table import read_table
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.effects import CATALOGUE, DECLARED, NAMES, PARAMETERS
from adaptsim_jax.tasks.pushing.slide import ROW, Push, slide

LEAST_ROWS, LEAST_RATE, LEAST_TRIALS = 10, 20.0, 5
MOVED = 0.01  # m: a bottle that moved less was not hit
FAR = 3.0  # m from the arm's base
SESSION, SESSION_NOISE = "robot.toml", 1e-3  # of `adaptsim robot`; m
ROWS = 160  # of a track that are kept, evenly


@dataclass(frozen=True)
class Tracks:
    """N pushes. actions [N, 2] m/s, rad; time [N, M] s since the arm's start, place [N, M, 2] m, seen [N, M] 0 or 1; noise m;
    notes: what a person should know of how they were read."""

    path: str
    trials: tuple[str, ...]
    actions: np.ndarray
    time: np.ndarray
    place: np.ndarray
    seen: np.ndarray
    noise: float
    notes: tuple[str, ...] = ()

    @property
    def duration(self) -> float:
        return float(np.ceil((self.time * self.seen).max() / ROW) * ROW)

    def without(self, names) -> "Tracks":
        """Without these trials. Raises BadInput where one is not there."""
        if unknown := sorted(set(names) - set(self.trials)):
            raise BadInput(
                f"{self.path}: no trial is named {unknown[0]!r}; --without takes of {', '.join(self.trials)}"
            )
        keep = [k for k, t in enumerate(self.trials) if t not in set(names)]
        pick = lambda z: z[keep]
        return replace(self, trials=tuple(self.trials[k] for k in keep), actions=pick(self.actions), time=pick(self.time),
                       place=pick(self.place), seen=pick(self.seen))  # fmt: skip


def read_tracks(folder: str | Path) -> Tracks:
    """A folder with `actions.csv` (trial, speed, angle) and tracks in other CSV files (trial, time, x, y), or the folder of an
    `adaptsim robot` session. Raises BadInput that names the file, the trial and the mend."""
    folder = Path(folder)
    if (folder / SESSION).exists():
        return _of_session(folder)
    actions = _actions(folder)
    columns = [_file(f) for f in _track_files(folder)]
    if not columns:
        raise BadInput(f"{folder}: holds no tracks; put CSV files with columns trial, time, x, y beside actions.csv")
    rows = {}
    for path, trial, time, xy in columns:
        for name in np.unique(trial):
            mine = trial == name
            key = f"{name:g}"
            if key in rows:
                raise BadInput(f"{path}: trial {key} is in another file too; number the trials of all files apart")
            rows[key] = _checked(path, key, time[mine], xy[mine])
    return _assembled(folder, actions, rows)


def _of_session(folder: Path) -> Tracks:
    """The pushes that were recorded in a session of `adaptsim robot`: six places of each."""
    from adaptsim_jax.core import store
    from adaptsim_jax.tasks.pushing.task import observed_rows

    history = store.read_manifest(folder / store.CHECKPOINT)["extra"]["history"]
    actions, rows = {}, {}
    when = 0.01 * (observed_rows(pushing.rows(pushing.PAPER)) + 1)
    for push in (p for visit in history for p in visit.get("pushes", [])):
        points = np.array(push["points"], float)
        if points.shape == (len(when), 2) and np.isfinite(points).all():
            name = f"{push['trial']:g}"
            actions[name], rows[name] = np.array(push["action"], float), (when, points)
    tracks = _assembled(folder, actions, rows)
    note = f"six places of each push are kept in a session; their noise is taken to be {1e3 * SESSION_NOISE:g} mm"
    return replace(tracks, noise=SESSION_NOISE, notes=(*tracks.notes, note))


def _track_files(folder: Path) -> list[Path]:
    records = folder / "records"
    found = sorted(folder.glob("*.csv")) + (sorted(records.glob("*.csv")) if records.is_dir() else [])
    return [f for f in found if "actions" not in f.stem and "next_experiment" not in f.stem]


def _actions(folder: Path) -> dict[str, np.ndarray]:
    out = {}
    for path in sorted(folder.glob("*actions.csv")):
        if path.stem == "best_actions":
            continue
        table = read_table(path, ("trial", "speed", "angle"), least=1).columns
        for name in ("trial", "speed", "angle"):
            if name not in table:
                raise BadInput(f"{path}: column '{name}' is missing; needed are trial, speed (m/s), angle (rad)")
        for n, speed, angle in zip(table["trial"], table["speed"], table["angle"], strict=True):
            if abs(angle) > 1.5:
                raise BadInput(f"{path}: trial {n:g}: angle {angle:g} rad; is it in degrees? write radians")
            if not 0.02 < speed < 3.0:
                raise BadInput(f"{path}: trial {n:g}: speed {speed:g} m/s is none of an arm; write m/s")
            out[f"{n:g}"] = np.array([speed, angle])
    if not out:
        raise BadInput(f"{folder}: holds no actions.csv; write one with columns trial, speed (m/s), angle (rad)")
    return out


def _file(path: Path):
    wanted = ("trial", "time", "x", "y")
    table = read_table(path, wanted, least=1).columns
    for name in wanted:
        if name not in table:
            raise BadInput(f"{path}: column '{name}' is missing; a track has trial, time (s), x, y (m)")
    return path, table["trial"], table["time"], np.stack([table["x"], table["y"]], 1)


def _checked(path: Path, trial: str, time: np.ndarray, xy: np.ndarray):
    told = f"{path}: trial {trial}"
    good = np.isfinite(xy).all(1) & np.isfinite(time)
    time, xy = time[good], xy[good]
    if len(time) < LEAST_ROWS:
        raise BadInput(f"{told}: has {len(time)} readings; a track needs {LEAST_ROWS}, take it out of the file")
    if np.any(np.diff(time) <= 0):
        raise BadInput(
            f"{told}: time does not increase at {time[1:][np.diff(time) <= 0][0]:g} s; sort the rows, or mend the clock"
        )
    rate = 1.0 / float(np.median(np.diff(time)))
    if time[-1] - time[0] > 100.0:
        raise BadInput(f"{told}: lasts {time[-1] - time[0]:.0f} s; is time in ms? write seconds")
    if rate < 0.9 * LEAST_RATE:
        raise BadInput(f"{told}: {rate:.3g} frames a second; a push needs {LEAST_RATE:g} or more")
    if np.abs(xy).max() > FAR:
        raise BadInput(f"{told}: a place of {np.abs(xy).max():.3g} m; are lengths in mm or cm? write metres")
    return time, xy


def _assembled(folder: Path, actions, rows) -> Tracks:
    missing = sorted(set(rows) - set(actions))
    if missing:
        raise BadInput(f"{folder}: trial {missing[0]} has a track but no row in actions.csv; add its speed and angle")
    notes, names = [], []
    for name in sorted(rows, key=float):
        time, xy = rows[name]
        if np.linalg.norm(xy - xy[0], axis=1).max() < MOVED:
            notes.append(f"trial {name}: the bottle never moved, so it was not hit; left out")
            continue
        names.append(name)
    if len(names) < LEAST_TRIALS:
        raise BadInput(
            f"{folder}: {len(names)} pushes with a motion; a diagnosis needs {LEAST_TRIALS}, better 12 or more"
        )
    unseen = sorted(set(actions) - set(rows), key=float)
    if unseen:
        notes.append(f"no track of trial {', '.join(unseen)}: left out")
    own = np.stack([actions[n] for n in names])
    for check in (_frame, _mirror):
        check(folder, names, own, rows)
    width = min(ROWS, max(len(rows[n][0]) for n in names))
    time, place, seen = np.zeros((len(names), width)), np.zeros((len(names), width, 2)), np.zeros((len(names), width))
    residue = []
    for k, n in enumerate(names):
        t, xy = rows[n]
        residue.append(_rough(xy))
        keep = np.unique(np.linspace(0, len(t) - 1, min(width, len(t))).round().astype(int))
        time[k, : len(keep)], place[k, : len(keep)], seen[k, : len(keep)] = t[keep], xy[keep], 1.0
        time[k, len(keep) :] = t[-1]
    noise = max(float(np.median(residue)), 1e-5)
    return Tracks(str(folder), tuple(names), own, time, place, seen, noise, tuple(notes))


def _rough(xy: np.ndarray) -> float:
    """Noise of a track from its third differences, of which a slide has next to none."""
    d = np.abs(np.diff(xy, 3, axis=0))
    return float(np.median(d)) / 0.6745 / np.sqrt(20.0)


def _frame(folder, names, actions, rows) -> None:
    first = np.median([rows[n][1][0] for n in names], axis=0)
    aside = float(np.linalg.norm(first - np.array(pushing.START)))
    if aside > 0.15:
        raise BadInput(
            f"{folder}: bottles stand at ({first[0]:.3g}, {first[1]:.3g}) m, {100 * aside:.0f} cm from {pushing.START}, where a push "
            "starts; give the tracks in the arm's base frame"
        )


def _mirror(folder, names, actions, rows) -> None:
    """Whether bottles go to the other side than the arm: one plain refit of headings."""
    off = np.array([rows[n][1][-1] - rows[n][1][0] for n in names])
    went, told = np.arctan2(off[:, 1], off[:, 0]), actions[:, 1]
    if np.ptp(told) < 0.1:
        return
    error = lambda z: float(np.median(np.abs((z + np.pi) % (2 * np.pi) - np.pi)))
    as_told = error(went - told)
    for what, other, mend in (
        ("y is mirrored", -went, "multiply y by -1"),
        ("x is mirrored", np.pi - went, "subtract x from twice the start's"),
        ("x and y are swapped", np.pi / 2 - went, "swap the columns x and y"),
    ):
        if as_told > 0.1 and error(other - told) < 0.3 * as_told:
            raise BadInput(
                f"{folder}: bottles go where the arm does not push, but do so if {what}; {mend} and run it again"
            )


def problem_of(tracks: Tracks) -> Problem:
    """The identification problem: residuals over all tracks in units of the noise."""
    duration = min(max(tracks.duration, 0.9), 6.0)
    action, time, place, seen = (jnp.asarray(z) for z in (tracks.actions, tracks.time, tracks.place, tracks.seen))
    scale = seen / tracks.noise
    one = partial(_residual, duration=duration)
    over = jax.jit(jax.vmap(one, (0, 0, 0, 0, 0)))

    @jax.jit
    def along(vector, ways, action, time, place, scale):
        at = lambda a, t, p, s: jax.vmap(
            lambda w: jax.jvp(lambda v: one(v, a, t, p, s), (vector,), (w,)), out_axes=(None, -1)
        )(ways)
        return jax.vmap(at)(action, time, place, scale)

    def residuals(vectors):
        with jax.enable_x64(True):
            return np.asarray(over(jnp.asarray(vectors), action, time, place, scale))

    def slopes(vector, which):
        ways = np.zeros((len(which), len(vector)))
        ways[np.arange(len(which)), which] = 1.0
        with jax.enable_x64(True):
            return tuple(
                np.asarray(z) for z in along(jnp.asarray(vector), jnp.asarray(ways), action, time, place, scale)
            )

    return Problem(PARAMETERS, CATALOGUE, DECLARED, residuals, slopes, tracks.trials, _starts())


def _starts() -> np.ndarray:
    """Vectors over Omega: where the patch lies is found from nearby only."""
    rows = []
    for mu in (0.09, 0.15):
        for e in (4.6, 5.4):
            for y in (-0.07, -0.025, 0.025, 0.07):
                row = np.array([p.off for p in PARAMETERS])
                row[:4] = mu, e, 0.5, y
                rows.append(row)
    return np.array(rows)


def _residual(vector, action, time, place, scale, *, duration):
    seen = predicted(vector, action, time, duration)
    off = jnp.clip((seen - place) * scale[:, None], -1e5, 1e5)
    return off.reshape(-1)


def errors(tracks: Tracks, problem: Problem, vectors: np.ndarray) -> np.ndarray:
    """Error of each push [N] m: root mean square over its rows, at vectors [N, P]."""
    r = problem.residuals(vectors) * tracks.noise
    return np.sqrt(np.square(r).sum(1) / np.maximum(tracks.seen.sum(1), 1))


def predicted(vector, action, time, duration: float):
    """Where the camera says that the bottle is [M, 2] m at `time [M]`, of one push at the parameters of `NAMES`."""
    p = dict(zip(NAMES, vector, strict=True))
    push = Push(p["mu"], 10.0 ** p["log_e"], p["mu_p"], p["y_p"], **{k: p[k] for k in Push._fields[4:]})
    rows = slide(push, action, duration)[:, :2]
    at = (time * (1.0 + p["clock_scale"]) - p["latency"]) / ROW
    low = jnp.clip(jnp.floor(at).astype(jnp.int32), 0, len(rows) - 2)
    share = jnp.clip(at - low, 0.0, 1.0)[:, None]
    x = rows[low] * (1.0 - share) + rows[low + 1] * share
    pivot = jnp.asarray(pushing.START)[None]
    c, s = jnp.cos(p["camera_turn"]), jnp.sin(p["camera_turn"])
    away = (1.0 + p["camera_scale"]) * (x - pivot)
    turned = jnp.stack([c * away[:, 0] - s * away[:, 1], s * away[:, 0] + c * away[:, 1]], 1)
    return pivot + turned + jnp.stack([p["camera_x"], p["camera_y"]])[None]


def is_session(folder: str | Path) -> bool:
    """Whether a folder is a session of `adaptsim robot` with pushes told."""
    from adaptsim_jax.core import store

    folder = Path(folder)
    if not (folder / SESSION).exists() or not (folder / store.CHECKPOINT).exists():
        return False
    history = store.read_manifest(folder / store.CHECKPOINT)["extra"]["history"]
    return any("pushes" in visit for visit in history)
