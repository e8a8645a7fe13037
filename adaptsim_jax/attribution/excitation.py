"""The motion to record next: the best of random ones by what it would show of a machine's model."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.attribution import model_toml
from adaptsim_jax.attribution.criteria import CHOICE
from adaptsim_jax.attribution.draws import Basis, basis, drawn
from adaptsim_jax.attribution.equation.balance import balances, residual
from adaptsim_jax.attribution.equation.models import part_of, within
from adaptsim_jax.attribution.machine import Machine, machine
from adaptsim_jax.attribution.posed import declared_vector, posed
from adaptsim_jax.attribution.problem import own_inertia, scaled_reach
from adaptsim_jax.attribution.shown import shown
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import Report, silent
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.logs.log import Log, LogTrial
from adaptsim_jax.logs.log_meta import LogMeta
from adaptsim_jax.mechanisms.allowed import Allowed
from adaptsim_jax.mend.model_toml import read_model_table


@dataclass(frozen=True)
class Noise:
    """What a recording of the motion is taken to have."""

    # of a joint's largest torque, in each row: current sensors
    torque: float = 5e-3
    # rad (m), of an angle in each row: an encoder behind a gear
    angle: float = 1e-4


@dataclass(frozen=True)
class Search:
    """How a motion is looked for. seconds, rate: of it, Hz; draws: random motions within limits;
    coarse: Hz, of the rows at which limits are looked at first.
    """

    seconds: float = 16.0
    rate: float = 100.0
    draws: int = 100
    coarse: float = 25.0
    seed: int = 0
    noise: Noise = Noise()


@dataclass(frozen=True)
class After:
    """A diagnosis: its model, torque that it left by joint [N m], and from which size on its
    recording showed what, by effect and joint.
    """

    path: str
    table: Mapping[str, Any]
    left: Mapping[str, float]
    seen: Mapping[tuple[str, str], float | None]


@dataclass(frozen=True)
class Excitation:
    """A motion [T, n], its torques [T, n], and what it shows (`shown`). losses: the criterion of
    every draw, and loss that of the motion: less is better.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    torque: np.ndarray
    rows: Sequence[Mapping[str, Any]]
    losses: np.ndarray
    loss: float


def read_after(folder: str | Path) -> After:
    """Of a folder that `diagnose` wrote. Raises BadInput where it is none of a machine."""
    path, file = Path(folder, "model.toml"), Path(folder, "report.json")
    if not path.exists() or not file.exists():
        raise BadInput(f"{folder}: has no model.toml and report.json; give the --out of diagnose")
    table, report = read_model_table(path), json.loads(file.read_text(encoding="utf-8"))
    if table.get("task") != "mechanism":
        raise BadInput(f"{path}: is no model of a machine; give a diagnosis of one")
    left = {
        name: row["before"] if row["after"] is None else row["after"]
        for name, row in report["error"]["per_channel"].items()
        if row["unit"] in ("N m", "N")
    }
    seen = {(row["name"], row["where"]): row["size"] for row in report["power"]}
    return After(str(path), table, left, seen)


def excited(
    may: Allowed, search: Search = Search(), after: After | None = None, report: Report = silent
) -> Excitation:
    """Of random motions the one that tells laws without shapes from what they are mistaken for at
    the least sizes (mean logarithm over laws and joints), with all that it shows.

    Raises BadInput where no draw keeps to the limits.
    """
    b, fine = (basis(search.seconds, rate) for rate in (search.coarse, search.rate))
    found = _drawn(b, may, search, report)
    laws = [e for e in MACHINE if not e.shapes and not e.jump and not e.describes]
    tables = []
    for genes in found:
        tables.append(_table(may, fine, genes, search.noise, after, laws))
        report(len(tables), len(found), "what they show")
    losses = _losses(tables)
    for k in np.argsort(losses):
        q, v, a = fine.motion(may.home, found[k])
        tau = may.bodies.torques(q, v, a)
        within_limits = np.all(np.abs(tau) <= may.torque) and np.all(np.abs(v) <= may.speed)
        if within_limits and may.bodies.touching(q) is None:
            rows = _table(may, fine, found[k], search.noise, after, MACHINE)
            if after is not None:
                rows = [r | {"so_far": after.seen.get((r["name"], r["where"]))} for r in rows]
            return Excitation(fine.time, q, v, a, tau, rows, losses, float(losses[k]))
    raise BadInput("no motion keeps to the limits between its rows; take another --seed")


def _losses(tables: Sequence[Sequence[Mapping[str, Any]]]) -> np.ndarray:
    """The criterion by motion. What one does not show at all counts as thrice the largest size at
    which another shows it; what none shows does not count.
    """
    sizes = np.array([[row["alone"] or np.nan for row in table] for table in tables], float)
    sizes = sizes[:, np.isfinite(sizes).any(0)]
    return np.mean(np.log(np.where(np.isnan(sizes), 3.0 * np.nanmax(sizes, 0), sizes)), 1)


def _table(
    may: Allowed,
    b: Basis,
    genes: np.ndarray,
    noise: Noise,
    after: After | None,
    effects: Sequence[Effect],
) -> list[dict[str, Any]]:
    """What a motion shows."""
    noisy, clean = (_recorded(may, b, genes, z, after) for z in (noise, None))
    problem = posed(noisy, effects, CHOICE.horizon)
    null = declared_vector(noisy, problem)
    reach = scaled_reach(problem, *own_inertia(problem, null))
    both = (balances(problem, m.tracks) for m in (noisy, clean))
    rows = []
    for rough, exact in zip(*both, strict=True):
        fitted = within(part_of(null, exact))
        left = residual(problem, rough, fitted) - residual(problem, exact, fitted)
        names = [problem.joint_names[j] for j in exact.group.joints]
        least = np.array([0.0 if after is None else after.left.get(name, 0.0) for name in names])
        rows += shown(problem, exact, fitted, reach, left, least)
    return rows


def _drawn(b: Basis, may: Allowed, search: Search, report: Report) -> list[np.ndarray]:
    rng, found = np.random.default_rng(search.seed), []
    for k in range(search.draws):
        genes = drawn(rng, b, may)
        found += [] if genes is None else [genes]
        report(k + 1, search.draws, "random motions")
    if not found:
        raise BadInput(
            f"{may.mechanism.path}: no motion from home keeps to the limits without touching "
            "something; give a key 'home' that is free, or exclude pairs of bodies (<exclude>)"
        )
    return found


def _recorded(
    may: Allowed, b: Basis, genes: np.ndarray, noise: Noise | None, after: After | None
) -> Machine:
    """The machine with a recording of the motion, noisy or not."""
    q, v, a = b.motion(may.home, genes)
    tau, rng = may.bodies.torques(q, v, a), np.random.default_rng(0)
    if noise is not None:
        q = q + noise.angle * rng.normal(size=q.shape)
        tau = tau + noise.torque * np.abs(tau).max(0) * rng.normal(size=q.shape)
    names, path = may.mechanism.tree.joint_names, may.mechanism.path
    trial = LogTrial("motion", b.time, q, None, tau)
    log = Log(path, LogMeta(), names, (trial,), "torque", names, names)
    made = machine(may.mechanism, log)
    return made if after is None else model_toml.applied(after.table, after.path, made)
