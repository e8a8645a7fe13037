"""One batch of a sweep: members that share a program, trained and adapted side by side. Killed and
taken up to the same bits.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.adaptation import sweep_plan as devices
from adaptsim_jax.adaptation.episode import StepPlan
from adaptsim_jax.adaptation.phase1 import Phase1, Phase1Hyper, archive_size, make_phase1
from adaptsim_jax.adaptation.phase2 import adapt, draw_starts
from adaptsim_jax.adaptation.sweep_spec import Member, SweepSpec
from adaptsim_jax.adaptation.training import learned
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.parallel import largest_divisor
from adaptsim_jax.core.store import MANIFEST, load_checkpoint, save_checkpoint
from adaptsim_jax.tasks.registry import TASKS, make_task

SAVING = 0.05  # of the time, at most, goes into checkpoints


class Programs(NamedTuple):
    """What a group of members is run with, `width` of them at once. States hold their keys as plain
    numbers.

    learned: `(seed, report) -> prepared`, what the task learns once for that seed, `()` where it
        learns nothing.
    init: `(prepared, seeds) -> state`. advance: `(prepared, state, hyper, numbers [n]) -> (state,
        (reward [n], finite [n]))`; the state that it is given is gone. finish: `(prepared, state,
        hyper, seeds, targets [T, D]) -> MemberResult`. All but `numbers` and `targets` have leading
        axes `[S]`, a multiple of the devices along members.
    """

    phase1: Phase1
    mesh: Any
    width: int
    learned: Callable
    init: Callable
    advance: Callable
    finish: Callable


class MemberResult(NamedTuple):
    """Of a member: whole `[]`, whether its weights are finite. For each of `T` targets the best
    visit's reward `[T]` and mean of E `[T, D]` (physical), rewards of all visits `[T, N, I + 1]`.
    """

    whole: Array
    best: Array
    params: Array
    rewards: Array


def make_programs(spec: SweepSpec, member: Member, width: int, split: devices.Split) -> Programs:
    """Programs for members alike to `member` in all that is static, `width` at a time."""
    config = member.config
    task = make_task(spec.task, config.task, "task")
    made = task.preparation
    mesh = devices.make_mesh(split)
    judge = _judge(spec.task, config.task)

    def phase1_of(ready):
        return make_phase1(ready, config.phase1, devices.spread(split))

    def task_of(prepared):
        return task if made is None else made.ready(prepared)

    phase1 = phase1_of(task)
    used = archive_size(phase1, phase1.config.rounds)

    def learned_by(seed, report):
        return () if made is None else learned(task, made, seed, None, report)

    def init(prepared, seed):
        state = phase1_of(task_of(prepared)).init(jax.random.key(seed))
        return state._replace(key=jax.random.key_data(state.key))

    def advance(prepared, state, hyper, numbers):
        state, info = phase1_of(task_of(prepared)).run(
            state._replace(key=jax.random.wrap_key_data(state.key)), hyper, numbers
        )
        return state._replace(key=jax.random.key_data(state.key)), (
            info.final_reward,
            jnp.isfinite(info.loss),
        )

    def finish(prepared, state, hyper, seed, targets):
        weights = state.learner.target
        start_key, run_key = jax.random.split(
            jax.random.key(seed)
        )  # as `adaptsim adapt --seed` does
        starts = draw_starts(start_key, state.archive, used, spec.starts)
        ready = task_of(prepared)

        def one(target, task=ready):
            plan = StepPlan(spec.iterations, hyper.delta, hyper.shrink)
            result = adapt(run_key, task, phase1.bdq, weights, starts, target, plan)
            best, rewards = judge(result, target)
            return best, task.space.physical(result.mean), rewards

        whole = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(weights)]))
        if ready.world is None or not spec.targets:
            return MemberResult(whole, *jax.lax.map(one, targets))
        found = [one(targets[i], ready.world(name)) for i, name in enumerate(spec.targets)]
        return MemberResult(whole, *jax.tree.map(lambda *x: jnp.stack(x), *found))

    def over(f, *batched, donated=()):
        return devices.over_members(f, mesh, batched, donated)

    return Programs(
        phase1,
        mesh,
        width,
        learned_by,
        over(init, True, True),
        over(advance, True, True, True, False, donated=(1,)),
        over(finish, True, True, True, True, False),
    )


def _judge(task: str, options: Table) -> Callable:
    """`(Phase2Result, target) -> (best [], rewards [N, I + 1])`, as the task deploys its
    policies.
    """
    kind = TASKS[task]
    face, made = kind.adapt, None
    if face is not None:
        made = configs.from_table(kind.config, options, "task")

    def judge(result, target):
        if face is not None:
            result = face.deployed(made, result, target)
        return result.reward, result.history.reward

    return judge


def run_batch(
    programs: Programs,
    spec: SweepSpec,
    members: list[Member],
    folder: Path,
    *,
    width: int,
    progress: Callable[[int, str], None],
    save_after: float = 30.0,
) -> tuple[list[Table], Any, Any]:
    """`(rows, state, prepared)` of at most `width` members, from `folder` if it has a
    checkpoint.
        A row is plain data:
    reward: of each round's last steps; faulty: the first round whose loss was not finite, -1 where
        all were; whole, best, params,
    rewards: see `MemberResult`. state, prepared: host arrays at the end, leaves `[width, ...]`.

    `progress(rounds done, note)` is called between chunks; a checkpoint is written when the last
    one is `save_after` s old, and less often where that would take more than a twentieth of the
    time.
    """
    phase1, mesh = programs.phase1, programs.mesh
    padded = [*members, *[members[-1]] * (width - len(members))]
    seeds = devices.put(np.array([m.config.seed for m in padded], np.uint32), mesh)
    hyper = devices.put(_stacked(padded), mesh)
    total, done = phase1.config.rounds, 0

    def report(at: int, count: int, note: str) -> None:
        progress(0, note)

    by_seed = {m.config.seed: programs.learned(m.config.seed, report) for m in members}
    prepared = jax.tree.map(lambda *x: np.stack(x), *[by_seed[m.config.seed] for m in padded])
    on_devices = devices.put(prepared, mesh)
    state = programs.init(on_devices, seeds)
    curves = tuple(np.zeros((width, total), t) for t in (np.float32, np.bool_))
    if (folder / MANIFEST).exists():
        like = {"state": jax.eval_shape(lambda x: x, state), "curves": curves}
        restored, done = load_checkpoint(folder, like, task=spec.task)
        state = devices.put(restored["state"], mesh)
        curves = tuple(map(np.array, restored["curves"]))
    saved, wait = time.monotonic(), save_after
    size = largest_divisor(min(members[0].config.every, total), total, done)
    while done < total:
        numbers = devices.put(np.arange(done, done + size), mesh, batched=False)
        state, found = programs.advance(on_devices, state, hyper, numbers)
        for curve, part in zip(curves, devices.fetch(found), strict=True):
            curve[:, done : done + size] = part
        done += size
        progress(done, f"reward {np.nanmean(curves[0][:, done - 1]):.2f}")
        if devices.agreed(done < total and time.monotonic() - saved >= wait):
            begun = time.monotonic()
            whole = devices.fetch(state)
            if devices.first():
                tree = {"state": whole, "curves": curves}
                save_checkpoint(folder, tree, task=spec.task, step=done, config_hash="")
            saved = time.monotonic()
            wait = max(save_after, (saved - begun) / SAVING)
    targets = devices.put(_targets(phase1, spec), mesh, batched=False)
    last = devices.fetch(programs.finish(on_devices, state, hyper, seeds, targets))
    rows = [_row(curves, last, i) for i in range(len(members))]
    return rows, devices.fetch(state) if spec.keep else None, prepared


def _row(curves: tuple[np.ndarray, ...], found: MemberResult, i: int) -> Table:
    """Of member i. curves: Rewards, and whether losses were finite, `[width, rounds]`."""
    reward, finite = (curve[i] for curve in curves)
    row = {name: getattr(found, name)[i].astype(float).tolist() for name in MemberResult._fields}
    return row | {
        "reward": reward.astype(float).tolist(),
        "faulty": -1 if finite.all() else int(np.argmin(finite)),
        "whole": bool(found.whole[i]),
    }


def _stacked(members: list[Member]) -> Phase1Hyper:
    return jax.tree.map(lambda *x: np.asarray(x, np.float32), *[m.config.hyper for m in members])


def _targets(phase1: Phase1, spec: SweepSpec) -> np.ndarray:
    task = phase1.task
    rows = [task.space.values(task.settings[name], name) for name in spec.targets]
    return np.array(rows, np.float32).reshape(len(rows), task.space.dim)


def halved(
    members: list[Member], run: Callable[[list[Member]], Any], failed: Callable[[Member, str], Any]
) -> list[Any]:
    """`run` on all members, or on halves where it raises, down to the ones that fail alone:
    `failed(member, reason)` for these. Bad input and interrupts are no member's fault and are
    raised.
    """
    try:
        return run(members)
    except (BadInput, KeyboardInterrupt):
        raise
    except Exception as error:
        if jax.process_count() > 1:
            raise  # the other programs wait for this one
        if len(members) == 1:
            return [failed(members[0], " ".join(f"{type(error).__name__}: {error}".split())[:300])]
    middle = len(members) // 2
    return [*halved(members[:middle], run, failed), *halved(members[middle:], run, failed)]
