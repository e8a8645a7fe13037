"""What every candidate would do to the measured outputs along a fitted trajectory: its signature.

The response to a small force held over one row follows from the linearised row map alone, so it is computed once; the
signature of any force is then a matrix product, and hundreds of candidates cost little. Commands enter as forces, an
extra inertia as minus itself times the acceleration, and measurement effects act on the outputs directly.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.kept_programs import kept
from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.effects.base import Reach
from adaptsim_jax.logs.segments import Windows
from adaptsim_jax.logs.types import Atom
from adaptsim_jax.sysid.dictionary import Columns, columns_of, force_rows, measured_change
from adaptsim_jax.sysid.estimate.fit_result import FitResult
from adaptsim_jax.sysid.estimate.variance import Linearised
from adaptsim_jax.sysid.forward import Drive, Model, Push, driven, first_angles, measure, row_step, switched_on


@dataclass(frozen=True)
class Path:
    """A fitted trajectory, windows first: time, dt as `[W, L+1]`, `[W, L]` s; x `[W, L+1, S]`; u `[W, L, U]` N m;
    impulse `[W, (L+1) Y, n, L]`: outputs, in standard deviations, per N m held over a row."""

    time: np.ndarray
    dt: np.ndarray
    x: np.ndarray
    u: np.ndarray
    impulse: np.ndarray


@dataclass(frozen=True)
class Signatures:
    """Candidates and their columns in `lin.atoms`; `path` is where they were computed."""

    atoms: tuple[Atom, ...]
    lin: Linearised
    path: Path


def signatures(
    model: Model,
    result: FitResult,
    windows: Windows,
    reach: Reach,
    *,
    effects: Sequence[str] | None = None,
    basis: Callable[[Path], np.ndarray] | None = None,
    compress: Callable[[Linearised], Linearised] | None = None,
) -> Signatures:
    """Linearise about `result` and give the signature of every instance at every shape on its grid.

    effects: names to include (all where None; none: the linearisation alone, at a tenth of the time). basis:
    `path -> [K', W, n, L]` more force columns (`generic_forces`), named `generic` and placed after the catalogue's.
    compress: a linear map of the rows (of all fields alike), applied before the large product. Effects already in the fit
    stay in it and are linearised about.
    """
    columns = columns_of(model.layout, reach, effects)
    sensed, forces = columns.split()
    with jax.enable_x64(True):
        args = jax.tree.map(jnp.asarray, (windows, result.theta, result.eff, result.mask, result.x0))
        path, motion = _path(model, *args)
        change = _changes(model, args[0], *args[2:4], motion, sensed) if sensed.effects else ()
    path = Path(*(np.asarray(z) for z in path))
    none = np.zeros((*path.impulse.shape[:2], 0), np.float32)
    shown = [none, *(np.moveaxis(c, 0, -1) for c in sensed.trim(change))]
    lin = _linearised(result, windows, path, np.concatenate(shown, 2))
    lin = lin if compress is None else compress(lin)

    def responses(group: Columns) -> dict[str, np.ndarray]:
        with jax.enable_x64(True):
            rows = _rows(model, *args[:4], motion, group)
        return {e.name: _respond(lin.impulse, f) for e, f in zip(group.effects, group.trim(rows), strict=True)}

    seen = {name: part for group in parallel_map(responses, forces) for name, part in group.items()}
    parts = [seen[e.name] for e in columns.effects if e.name in seen] + [lin.atoms]
    atoms = columns.atoms
    if basis is not None:
        extra = basis(path)
        first = sum(p.shape[2] for p in parts)
        atoms += tuple(Atom("generic", "", {"term": float(i)}, (first + i,)) for i in range(len(extra)))
        parts.append(_respond(lin.impulse, extra))
    return Signatures(atoms, replace(lin, atoms=np.concatenate(parts, 2)), path)


def _respond(impulse: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Output change `[W, M, K]` of force rows `[K, W, n, L]`."""
    count, windows = rows.shape[:2]
    flat = np.ascontiguousarray(rows.reshape(count, windows, -1).transpose(1, 2, 0), np.float32)
    return impulse.astype(np.float32).reshape(windows, impulse.shape[1], -1) @ flat


def _linearised(result: FitResult, windows: Windows, path: Path, atoms: np.ndarray) -> Linearised:
    count, length, channels = windows.measured.shape
    flat = lambda z: np.asarray(z).reshape(count, length * channels, *z.shape[3:])
    return Linearised(
        residual=flat(result.residual),
        jac_state=result.jac_state,
        jac_theta=result.jac_shared,
        atoms=atoms,
        impulse=path.impulse,
        dt=path.dt,
        channel=np.tile(np.arange(channels), length),
        trial=np.asarray(windows.trial),
        used=flat(windows.weight) > 0,
    )


@kept(Drive)
def _path(model: Model, windows: Windows, theta, eff, mask, x0):
    """The fields of `Path`, and what drives the windows with the states `[L+1, S, W]` that come of it."""
    eff = model.layout.masked(eff, mask)
    drive = driven(model, theta, eff, mask, windows)
    x, phi, gamma = _row_maps(model, theta, eff, mask, drive, x0.T, windows.substeps)
    see = partial(_sensed, model, eff, mask, drive, x, first_angles(windows, x[0]))
    impulse = _impulse(see, phi, gamma, _weight(windows))
    first = lambda z: jnp.moveaxis(z, -1, 0)
    return (drive.time.T, drive.dt.T, first(x), first(drive.u), impulse), (drive, x)


@kept()
def _rows(model: Model, windows: Windows, theta, eff, mask, motion, columns: Columns):
    drive, x = motion
    return force_rows(model, theta, model.layout.masked(eff, mask), mask, windows, drive, x, columns)


@kept()
def _changes(model: Model, windows: Windows, eff, mask, motion, columns: Columns):
    drive, x = motion
    return measured_change(model, model.layout.masked(eff, mask), mask, windows, drive, x, columns, _weight(windows))


def _weight(windows: Windows) -> jax.Array:
    return jnp.asarray(windows.weight).transpose(1, 2, 0)


def _row_maps(model: Model, theta, eff, mask, drive, x0, substeps):
    """States `[L+1, S, W]`, and the derivatives of each row's end state by its start `[L, S, S, W]` and by a held force
    `[L, S, n, W]`.

    One scan makes all three, so that the step is traced once. Memories are held: their own change with the motion is
    second order in what is added.
    """
    states, joints = x0.shape[0], model.plant.joint_dim
    zero = jnp.zeros((joints, x0.shape[1]), x0.dtype)
    on = switched_on(model, mask)
    eye = jnp.eye(states + joints, dtype=x0.dtype)[:, :, None] * jnp.ones((1, 1, x0.shape[1]), x0.dtype)

    def row(carry, now):
        (x, memory), (u, ramp, t, dt) = carry, now

        def end(x, force):
            x, after = row_step(model, theta, eff, x, memory, u, t, dt, Push(force, zero), substeps, on, ramp)
            return jnp.stack(x), after

        along = jax.vmap(lambda *way: jax.jvp(end, (x, zero), way), out_axes=(None, 0))
        new, (maps, _) = along(eye[:, :states], eye[:, states:])
        return new, (x, jnp.swapaxes(maps, 0, 1))

    last, (x, maps) = jax.lax.scan(row, (x0, drive.memory), (drive.u, drive.ramp, drive.stamps[:-1], drive.dt))
    return jnp.concatenate([x, last[0][None]]), maps[:, :, :states], maps[:, :, states:]


def _impulse(see, phi, gamma, weight):
    """Weighted response `[W, (L+1) Y, n, L]` (float32) to a unit force at each joint held over each row."""
    length, states, joints, windows = gamma.shape
    channels = weight.shape[1]

    def row(dx, now):
        phi, gamma, i = now
        new = sum(phi[:, s, :, None, None] * dx[s][None] for s in range(states))
        here = (jnp.arange(length) == i).reshape(1, 1, 1, length)
        new = new + jnp.moveaxis(gamma, 2, 1)[..., None] * here
        return new, new

    zero = jnp.zeros((states, windows, joints, length), phi.dtype)
    _, dx = jax.lax.scan(row, zero, (phi, gamma, jnp.arange(length)))
    dx = jnp.concatenate([zero[None], dx])  # [L+1, S, W, n, L]
    dy = see(dx, channels)
    dy = dy * weight[:, :, :, None, None]
    return dy.transpose(2, 0, 1, 3, 4).reshape(windows, -1, joints, length).astype(jnp.float32)


def _sensed(model: Model, eff, mask, drive, x, first, dx, channels: int):
    """What the sensors make of a change of state `[L+1, S, W, ...]`; linear, and the identity where none acts."""
    if not list(model.layout.placed("measurement")):
        return jax.vmap(model.plant.output)(dx)[:, :channels]
    shape = dx.shape[3:]
    flat = jnp.moveaxis(dx.reshape(*dx.shape[:3], -1), -1, 0)
    on = jnp.asarray(mask, bool)[
        jnp.array([i for i, k in enumerate(model.layout.instances) if k.effect.place == "measurement"])
    ].any()
    see = lambda x: measure(model, eff, mask, drive.time, x, first, channels)
    through = lambda d: jax.lax.map(lambda z: jax.jvp(see, (x,), (z,))[1], d, batch_size=32)
    plain = lambda d: jax.vmap(jax.vmap(model.plant.output))(d)[:, :, :channels]
    dy = jax.lax.cond(on, through, plain, flat)
    return jnp.moveaxis(dy, 0, -1).reshape(*dy.shape[1:], *shape)
