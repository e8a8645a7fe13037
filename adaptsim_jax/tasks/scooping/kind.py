"""Scooping as the registry holds it: what `adaptsim adapt` shows of it, how trials end over
iterations and films of them; and what `adaptsim robot` says and reads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.logs.table import LogTable
from adaptsim_jax.tasks.base import AdaptFace, AdaptView, Look, SessionTrials, TaskKind
from adaptsim_jax.tasks.camera_record import row_namer
from adaptsim_jax.tasks.robot_trials import AskedTrials, History, TrialSessions, config_of
from adaptsim_jax.tasks.scooping import hydro, measured
from adaptsim_jax.tasks.scooping import task as scooping
from adaptsim_jax.tasks.scooping.config import checked
from adaptsim_jax.tasks.scooping.deployed import make_probe
from adaptsim_jax.tasks.scooping.diagnosis.read import assemble
from adaptsim_jax.tasks.scooping.engines import BACKENDS, PARITY
from adaptsim_jax.tasks.scooping.model import SECONDS
from adaptsim_jax.tasks.scooping.motion import check_way
from adaptsim_jax.tasks.scooping.one_shot import make_scooping_one_shot
from adaptsim_jax.tasks.scooping.task import ScoopingConfig, make_scooping

if TYPE_CHECKING:
    from adaptsim_jax.commands.robot_session import RobotSession


SYMBOLS = {"mu": "μ piece", "e": "e (Pa)", "g": "shape", "h": "h (m)"}


def clips_of(config: Any, policies: Any, target: np.ndarray) -> list[Any]:
    """A clip of each of `policies [P]`: what it does in the target, without an error of
    execution.
    """
    from adaptsim_jax.tasks.scooping.film import ScoopClip

    act, options = scooping.make_policy(config), checked(config)

    @jax.jit
    @jax.vmap
    def run(one):
        action, params = act(one, jnp.zeros(2)), jnp.asarray(target, jnp.float32)
        return action, hydro.rollout(params, action, options, config.numerics)

    actions, scoops = run(policies)
    clips = []
    for i, (pitch, rate, distance) in enumerate(np.asarray(actions)):
        angle = f"{np.degrees(pitch):.1f} deg, {rate:+.2f} rad/s"
        text = f"iteration {i}: {angle}, {1e3 * distance:.0f} mm"
        piece, tip = np.asarray(scoops.piece[i]), np.asarray(scoops.tip[i])
        clips.append(ScoopClip(piece, tip, target, bool(scoops.success[i] > 0.5), text))
    return clips


def shown(view: AdaptView) -> Look:
    """The start that holds the best visit."""
    from adaptsim_jax.report.figures_comparison import axes_of
    from adaptsim_jax.tasks.scooping import film

    clips = clips_of(view.config, view.policies, view.values)
    iterations, heads = view.picked(len(clips))
    rewards = view.of_start(view.result.history.reward)
    figure = film.scoops_over_iterations(
        [clips[i] for i in iterations],
        heads,
        [float(rewards[i]) for i in iterations],
        view.params,
        axes_of(view.task.space, SYMBOLS),
        target=list(view.values),
    )
    notes = ()
    if (count := view.trials_reported()) is not None:
        notes = (f"scoops are corrected by those made before, the best policy's by all {count}",)
    visits = [0, view.best] if view.best else [0]
    return Look(figure, lambda: [clips[i] for i in visits], notes)


def before_after(config: Any, both: Any, target: np.ndarray) -> Look:
    """The scoops of two policies, before and after adaptation."""
    from adaptsim_jax.tasks.scooping import film

    clips = clips_of(config, both, target)
    figure = film.film_strips(clips, ("before", "after"))
    return Look(figure, lambda: clips, ends=tuple(film.ending(clip) for clip in clips))


def scene() -> Any:
    from adaptsim_jax.tasks.scooping.film import SCENE

    return SCENE


ADAPT = AdaptFace("scoops", shown, scene, before_after, as_compared=lambda config: config.correct)


HOW = """for each, lay the piece at that place (m from the middle of a box of 8 x 6 cm, x along the spatula's way), start at
that pitch and distance, scoop with that pitch rate at 0.25 s, and track the piece for {seconds:g} s; write one CSV for all of them
with columns trial, time, x, y, on (s since the arm's start; m; 1 where the piece lies on the spatula, else 0)"""  # noqa: E501
COLUMNS = ("place_x", "place_y", "pitch", "rate", "distance")


def in_words(action: Any) -> str:
    """An action `[3]` in words."""
    pitch, rate, distance = map(float, action)
    return (
        f"pitch {math.degrees(pitch):.2f} deg, pitch rate {rate:+.3f} rad/s, distance "
        f"{1e3 * distance:.1f} mm"
    )


class ScoopSessions(TrialSessions):
    """Scoops of a piece, tracked by a camera."""

    trials = "scoops"
    columns = COLUMNS
    measured = measured
    keys = ("place", "action", "points", "success")
    result = "success"
    read_again = ("place", "action")

    @property
    def recorded(self) -> SessionTrials:
        """Each track is counted from where its piece lay."""
        head = ",".join(("trial", *COLUMNS))
        own_frame = partial(assemble, own_frame=True)
        return SessionTrials(head, self.rows_again, ("clearance",), own_frame)

    def how(self, config: Any) -> str:
        return HOW.format(seconds=SECONDS)

    def asked(self, context: Any, action: Any) -> str:
        return f"{in_words(action)}   (piece at {context[0]:+.3f}, {context[1]:+.3f} m)"

    def came(self, trajectory: Any) -> Iterator[str]:
        """Which scoops succeeded."""
        for success in trajectory.success:
            yield "on the spatula" if success > 0.5 else "not on the spatula"

    def ended(self, trial: Mapping[str, Any]) -> Any:
        return trial["success"]

    def visiting(self, config: Any) -> Callable[[Any], Any] | None:
        """Where the policy is corrected, the last scoop of an iteration is a probe."""
        return jax.jit(make_probe(config)) if config.correct else None

    def trajectory(
        self, session: RobotSession, tried: Any, asked: AskedTrials, table: LogTable, path: Path
    ) -> Any:
        where = str(path)
        found = measured.measured_trajectory(table.columns, row_namer(path, table), where, asked)
        if not session.as_declared:
            check_way(np.asarray(found.points[:, -1], float), where, asked.numbers.tolist())
        return found

    def finish(self, session: RobotSession, policy: Any, history: History) -> None:
        """How the best policy is used."""
        action = measured.scoop_in_the_middle(policy, config_of(session))
        if policy.told is not None:
            print(f"its scoop is corrected by the {len(policy.told.used)} scoops told")
        print(f"its scoop for a piece in the middle: {in_words(action)}; for any other place (m):")
        print("  from adaptsim_jax.tasks.scooping.measured import read_policy")
        print(
            f"  pitch, rate, distance = read_policy({str(session.folder / 'best.toml')!r})([0.01, "
            "0.02])"
        )


TASK = TaskKind(
    ScoopingConfig,
    make_scooping,
    make_scooping_one_shot,
    adapt=ADAPT,
    robot=ScoopSessions(),
    symbols=SYMBOLS,
    backends=BACKENDS,
    parity=PARITY,
)
