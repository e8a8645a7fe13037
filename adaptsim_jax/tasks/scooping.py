"""Scooping a piece of food (paper, section 5.2 and appendix A4): a NAF network chooses how to move the spatula.

The policy maps where the piece lies to pitch, pitch rate and distance. It is trained at parameters drawn from E, on trials of
the hydroelastic engine itself or of the bank (`scooping_bank`), a smoothed store of such trials that all policies share; Phase 1
may rehearse on the bank, too. At each adaptation iteration it is tried twice; the piece's tracks in these trials, as a camera
sees them, are all that the adaptation policy is shown. Trials execute their actions with an error. In a simulated target the
reward is the mean over a fixed set of places and errors: the share of pieces that lie on the spatula at the end.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import space as spaces
from adaptsim_jax.errors import BadInput
from adaptsim_jax.learners.naf import NAF, NAFConfig, NAFHyper, make_naf
from adaptsim_jax.learners.naf_goals import GoalConfig, GoalProblem, make_goal_learner
from adaptsim_jax.models import scooping as model
from adaptsim_jax.models import scooping_hydro as hydro
from adaptsim_jax.models.scooping import ScoopOptions
from adaptsim_jax.models.scooping_hydro import Numerics
from adaptsim_jax.space import Parameter, Space
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.scooping_bank import BOXES as BANK_BOXES
from adaptsim_jax.tasks.scooping_bank import Bank, load_bank
from adaptsim_jax.tasks.scooping_told import Told

# Paper, table A2: friction, modulus Pa, shape (0 ellipsoid, 1 cylinder, 2 box), height m.
SETTINGS = {
    "wd": {"mu": 0.30, "e": 5e4, "g": 1, "h": 0.020},
    "ood-1": {"mu": 0.45, "e": 1e4, "g": 0, "h": 0.014},
    "ood-2": {"mu": 0.20, "e": 5e4, "g": 1, "h": 0.022},
    "ood-3": {"mu": 0.30, "e": 1e6, "g": 0, "h": 0.028},
    "ood-4": {"mu": 0.40, "e": 1e5, "g": 2, "h": 0.019},
}
POINTS = len(model.SEEN_AT)
PLACES = np.array([0.04, 0.03])
"""Half the box that pieces are placed in, 8 by 6 cm about its middle, m."""
CONTEXT = 5
"""Numbers of a trial's context: the piece's place `[2]` m, all that the policy sees of it; then what no one knows beforehand:
errors of pitch and rate in [-1, 1], and a number in [0, 1) that the camera's noise is drawn with."""
_SPAN = 0.15  # m: places seen are divided by it


@dataclass(frozen=True)
class ScoopingConfig:
    """Options of the task.

    trajectories: trials an iteration; tests: places and errors that the reward of a simulated target is averaged over.
    targets: Phase 1 draws targets from Omega (the paper), or from a box around it, boxes included (`wide`).
    source: of the trials that policies are trained with: the `bank`, or the `simulator`; rehearsal: of the targets that Phase 1
    learns from, likewise. lucks: execution errors that a trial of the bank is averaged over. checks: places and errors that the
    best of a training's policies is chosen by, in the bank; 0 keeps the last one. correct: what is deployed is the best action by
    the bank at E's mean as mended by the scoops made in the target so far (`scooping_told`); a visit's own scoops are not, nor is
    anything in Phase 1. trials: M of the paper; training: how;
    hidden, learning_rate: of the NAF. clearance, noise: difficulty, see `models.scooping.ScoopOptions`.
    camera: mean along the motion and standard deviation of the noise on observed places, m. numerics: of the engine.
    mu, e, h: Omega.
    """

    trajectories: int = 2
    tests: int = 6
    targets: Literal["omega", "wide"] = "wide"
    source: Literal["bank", "simulator"] = "bank"
    rehearsal: Literal["bank", "simulator"] = "bank"
    lucks: int = 4
    checks: int = 16
    correct: bool = False
    trials: int = 1200
    training: GoalConfig = field(
        default_factory=lambda: GoalConfig(
            updates=60, batch=32, candidates=32, capacity=1200, temperature=0.05, width=(0.4, 0.08)
        )
    )
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 3e-3
    clearance: float = ScoopOptions().clearance
    noise: tuple[float, ...] = ScoopOptions().noise
    camera: tuple[float, ...] = (0.002, 0.002)
    numerics: Numerics = field(default_factory=Numerics)
    mu: tuple[float, float] = (model.LOW[0], model.HIGH[0])
    e: tuple[float, float] = (model.LOW[1], model.HIGH[1])
    h: tuple[float, float] = (model.LOW[3], model.HIGH[3])


class ScoopingPolicy(NamedTuple):
    """weights: `[n]` of the NAF; `make_policy(config)` gives what it does. Where deployed policies are corrected (else None): at:
    `[D]`, the mean of E (unit coordinates) that it stands for; told: the target's scoops that it is corrected by, if any."""

    weights: jax.Array
    at: jax.Array | None = None
    told: Told | None = None


class ScoopingTrajectory(NamedTuple):
    """points: `[N, 8, 2]` m, the piece as the camera saw it, from where it lay; success: `[N]` of these trials; tested: `[]`,
    mean over the test contexts (in simulation only; elsewhere the mean of `success`)."""

    points: jax.Array
    success: jax.Array
    tested: jax.Array


def scooping_space(config: ScoopingConfig = ScoopingConfig()) -> Space:
    """Omega: friction, modulus on a logarithmic scale, shape as a category, height."""
    bounds: list[dict[str, Any]] = [
        {"physical_low": a, "physical_high": b} for a, b in zip(model.PHYSICAL_LOW, model.PHYSICAL_HIGH, strict=True)
    ]
    return Space(
        (
            Parameter("mu", *config.mu, **bounds[0], description="friction of the piece with table and blade"),
            Parameter("e", *config.e, "Pa", "log", **bounds[1], description="modulus of the piece's surface"),
            Parameter("g", 0, 1, "", "categorical", **bounds[2], description="shape: 0 ellipsoid, 1 cylinder (2 box)"),
            Parameter("h", *config.h, "m", **bounds[3], description="height of the piece"),
        )
    )


def wide_space() -> Space:
    """A box around Omega for Phase-1 targets that Omega cannot reproduce; boxes among them."""
    return Space(
        (
            Parameter("mu", 0.15, 0.5),
            Parameter("e", 8e3, 1.5e6, "Pa", "log"),
            Parameter("g", 0, 2, "", "categorical"),
            Parameter("h", 0.013, 0.03, "m"),
        )
    )


def draw_context(key: jax.Array) -> jax.Array:
    """A context `[5]` of a trial; see `CONTEXT`."""
    u = jax.random.uniform(key, (CONTEXT,))
    return jnp.concatenate([(2.0 * u[:2] - 1.0) * jnp.asarray(PLACES, u.dtype), 2.0 * u[2:4] - 1.0, u[4:]])


def seen_place(context: jax.Array) -> jax.Array:
    """What the policy sees of `contexts [..., >= 2]`: the place, in [-1, 1]."""
    lead = (1,) * (context.ndim - 1)
    return context[..., :2] / jnp.asarray(PLACES, context.dtype).reshape(*lead, 2)


def executed(action: jax.Array, context: jax.Array, options: ScoopOptions) -> jax.Array:
    """What is done when `action [3]` in [-1, 1] is asked for: (pitch rad, rate rad/s, distance m), with the context's errors."""
    errors = jnp.concatenate([context[2:4], jnp.zeros(1, context.dtype)])
    return model.physical_action(action) + errors * jnp.asarray(options.noise, action.dtype)


def make_trial(options: ScoopOptions, numerics: Numerics) -> Callable[[jax.Array, jax.Array, jax.Array], jax.Array]:
    """`trial(params [4], action [3], context [5]) -> outcome [9, 2]` in the engine: eight places m from where the piece lay,
    and (success, height over the tip's plane m); not-a-number, success 0, where the engine reports a fault."""
    rows = hydro.seen_rows(numerics)

    def trial(params, action, context):
        out = hydro.rollout(params, executed(action, context, options), options, numerics)
        x = out.piece[rows, 0]
        places = jnp.stack([x, jnp.zeros_like(x)], -1)
        found = jnp.concatenate([places, jnp.stack([out.success, out.above])[None]])
        return jnp.where((out.code == model.DIVERGED) | (out.code == model.UNFIT), jnp.nan, found)

    return trial


def success(outcome: jax.Array) -> jax.Array:
    """`[...]`: 1 where the piece of `outcome [..., 9, 2]` lies on the spatula at the end; 0 where it is not finite."""
    return jnp.where(outcome[..., -1, 0] > 0.5, 1.0, 0.0)


def camera_view(points: jax.Array, context: jax.Array, camera: tuple[float, ...]) -> jax.Array:
    """`points [8, 2]` m as the camera sees them: blurred ahead, and noisy (paper, appendix). The context seeds the noise."""
    seed = jnp.floor(context[4] * 2.0**23).astype(jnp.uint32)
    noise = jax.random.normal(jax.random.key(seed), points.shape, points.dtype)
    return points + jnp.array([[camera[0], 0.0]], points.dtype) + camera[1] * noise


def make_scooping_naf(config: ScoopingConfig) -> NAF:
    """The learner whose weights a `ScoopingPolicy` holds."""
    return make_naf(NAFConfig(obs_dim=2, action_dim=3, hidden=config.hidden))


def make_policy(config: ScoopingConfig = ScoopingConfig()) -> Callable[[ScoopingPolicy, jax.Array], jax.Array]:
    """`act(policy, places [..., 2] m) -> [..., 3]`: pitch rad, rate rad/s, distance m. Pure."""
    naf = make_scooping_naf(config)
    return lambda policy, places: model.physical_action(naf.greedy(policy.weights, seen_place(places)))


def make_scooping(config: ScoopingConfig = ScoopingConfig()) -> Task:
    """Scooping as a `Task`, simulated with the hydroelastic engine."""
    space, naf = scooping_space(config), make_scooping_naf(config)
    draw = lambda key, dist: space.physical(spaces.sample(key, dist))
    learner = make_goal_learner(naf, training_problem(config, draw), config.training, naf_rates(config))
    block = config.training.block
    at_mean = lambda weights, mean: ScoopingPolicy(weights, mean if config.correct else None)

    def train_many(keys, dists, policies, trials):
        rounds = (trials + block - 1) // block
        return at_mean(learner.train(keys, policies.weights, dists, rounds, jnp.max(rounds)), dists.mean)

    def train(key, dist, policy):
        one = jax.tree.map(lambda x: x[None], (dist, policy.weights))
        rounds = -(-config.trials // block)
        return at_mean(learner.train(key[None], one[1], one[0], jnp.full(1, rounds), rounds)[0], dist.mean)

    rollout, rehearse = make_rollouts(config, naf)

    return Task(
        name="scooping",
        space=space,
        targets=space if config.targets == "omega" else wide_space(),
        obs_dim=config.trajectories * POINTS * 2,
        settings=SETTINGS,
        init_policy=lambda key: at_mean(naf.init(key).online, jnp.full(space.dim, 0.5)),
        train=train,
        rollout=rollout,
        observe=observed,
        score=lambda trajectory: trajectory.success.mean(),
        reference=lambda params: jnp.zeros(()),
        reward=lambda trajectory, reference: trajectory.tested,
        train_many=train_many,
        rehearse=rehearse,
    )


def make_rollouts(config: ScoopingConfig, naf: NAF) -> tuple[Callable, Callable | None]:
    """`rollout` of the task in the engine, and `rehearse` in the bank; None where Phase 1 is to run in the engine, too."""
    options, N = checked(config), config.trajectories
    tests = jnp.asarray(test_contexts(config.tests))
    trial = make_trial(options, config.numerics)

    def run(key, policy, params, outcome_of):
        contexts = jax.vmap(draw_context)(jax.random.split(key, N))
        every = jnp.concatenate([contexts, tests])
        actions = naf.greedy(policy.weights, seen_place(every))
        return contexts, jax.vmap(outcome_of, (None, 0, 0))(params, actions, every)

    def rollout(key, policy, params):
        contexts, outcomes = run(key, policy, params, trial)
        return measured(contexts, outcomes[:N], config.camera, success(outcomes[N:]).mean())

    if config.rehearsal == "simulator":
        return rollout, None
    bank = load_bank(options, config.numerics)

    def likely(params, action, context):
        done = executed(action, context, options)
        return bank_chance(bank, params, done), done

    def rehearse(key, policy, params):
        run_key, coin_key = jax.random.split(key)
        contexts, (chance, done) = run(run_key, policy, params, likely)
        won = (jax.random.uniform(coin_key, (N,)) < chance[:N]).astype(done.dtype)
        outcomes = jax.vmap(lambda a, w: bank_outcome(bank, params, a, w))(done[:N], won)
        return measured(contexts, outcomes, config.camera, chance[N:].mean())

    return rollout, rehearse


def measured(
    contexts: jax.Array, outcomes: jax.Array, camera: tuple[float, ...], tested: jax.Array | None = None
) -> ScoopingTrajectory:
    """The trajectory of `N` trials in `contexts [N, 5]` from their `outcomes [N, 9, 2]`, of any engine."""
    points = jax.vmap(lambda o, c: camera_view(o[:-1], c, camera))(outcomes, contexts)
    lies = success(outcomes)
    return ScoopingTrajectory(points, lies, lies.mean() if tested is None else tested)


def observed(trajectory: ScoopingTrajectory) -> jax.Array:
    """`[obs_dim]`: places along and across the table in units of 15 cm; far out they are held at 4."""
    seen = trajectory.points / _SPAN
    return jnp.clip(jnp.where(jnp.isfinite(seen), seen, 4.0), -4.0, 4.0).reshape(-1)


def training_problem(
    config: ScoopingConfig, draw: Callable[[jax.Array, Any], jax.Array], checks: int | None = None
) -> GoalProblem:
    """What a NAF is trained on: places as goals, trials of the configured source at `draw(key, context) -> params [4]`.

    A trial of the bank is worth its chance of success, which is what many trials with one action would come to.
    """
    options = checked(config)
    checks = config.checks if checks is None else checks
    place = lambda key: draw_context(key)[:2]
    reward = lambda outcome, goal: outcome[0]
    if config.source == "simulator":
        simulate = make_trial(options, config.numerics)

        def real(key, context, action):
            draw_key, luck_key = jax.random.split(key)
            return success(simulate(draw(draw_key, context), action, draw_context(luck_key)))[None]

        return GoalProblem(place, seen_place, real, reward)
    bank = load_bank(options, config.numerics)
    tests = jnp.asarray(test_contexts(max(checks, 1)))
    chances = jax.vmap(lambda p, a, luck: bank_chance(bank, p, executed(a, luck, options)))

    def stored(key, context, action):
        draw_key, luck_key = jax.random.split(key)
        params = jax.vmap(draw, (0, None))(jax.random.split(draw_key, config.lucks), context)
        lucks = jax.vmap(draw_context)(jax.random.split(luck_key, config.lucks))
        return chances(params, jnp.broadcast_to(action, (config.lucks, 3)), lucks).mean()[None]

    def worth(key, context, act):
        params = jax.vmap(draw, (0, None))(jax.random.split(key, checks), context)
        return chances(params, jax.vmap(act)(tests[:, :2]), tests).mean()

    return GoalProblem(place, seen_place, stored, reward, worth if checks else None)


def bank_chance(bank: Bank, params: jax.Array, action: jax.Array) -> jax.Array:
    """Chance of success `[]` at `params [4]` of `action [3]` as executed, by the bank."""
    return jax.nn.sigmoid(bank.logit(params, action))


def expected_odds(bank: Bank, params: jax.Array, action: jax.Array, options: ScoopOptions) -> jax.Array:
    """Log odds of success `[]` at `params [4]` when `action [3]` in [-1, 1] is asked for: of the mean chance over its errors, by
    Gauss's rule of two points for each."""
    errors = jnp.array([(a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]) / np.sqrt(3.0)
    lucks = jnp.zeros((len(errors), CONTEXT)).at[:, 2:4].set(errors)
    logits = jax.vmap(lambda luck: bank.logit(params, executed(action, luck, options)))(lucks)
    won, lost = (jax.nn.logsumexp(jax.nn.log_sigmoid(sign * logits)) for sign in (1.0, -1.0))
    return won - lost


def bank_outcome(bank: Bank, params: jax.Array, action: jax.Array, won: jax.Array) -> jax.Array:
    """An outcome `[9, 2]` as `make_trial`'s, of a trial of the bank that ended as `won []` says; the last height is 0."""
    x = bank.places(params, action, won)
    places = jnp.stack([x, jnp.zeros_like(x)], -1)
    return jnp.concatenate([places, jnp.stack([won, jnp.zeros_like(won)])[None]])


def test_contexts(count: int) -> np.ndarray:
    """`[count, 5]`: places and errors spread evenly, the same for every policy (a lattice of irrational steps)."""
    row = np.arange(count)[:, None] + 0.5
    u = row * np.array([0.8566749, 0.7338919, 0.6287067, 0.5385973, 0.4614027]) % 1.0
    return np.concatenate([(2 * u[:, :2] - 1) * PLACES, 2 * u[:, 2:4] - 1, u[:, 4:]], 1).astype(np.float32)


test_contexts.__test__ = False  # type: ignore[attr-defined]  # for pytest, which collects by name


def naf_rates(config: ScoopingConfig) -> NAFHyper:
    """Rates of the task policy's learner."""
    return NAFHyper(learning_rate=config.learning_rate, max_grad_norm=10.0)


def checked(config: ScoopingConfig) -> ScoopOptions:
    """The engine's options, if the config makes sense; BadInput names the key otherwise."""
    for name in ("trajectories", "tests", "trials", "lucks"):
        if getattr(config, name) < 1:
            raise BadInput(f"scooping, {name} = {getattr(config, name)}: give at least 1")
    if config.checks < 0:
        raise BadInput(f"scooping, checks = {config.checks}: give 0 to keep the last policy of a training, or more")
    if config.learning_rate <= 0:
        raise BadInput(f"scooping, learning_rate = {config.learning_rate}: give a positive one, such as 3e-3")
    if len(config.camera) != 2 or config.camera[1] < 0:
        raise BadInput(f"scooping, camera = {config.camera}: give a mean and a standard deviation of at least 0, in m")
    hydro.check_numerics(config.numerics)
    _check_covered(config)
    return model.check_options(ScoopOptions(clearance=config.clearance, noise=config.noise))


def _check_covered(config: ScoopingConfig) -> None:
    """BadInput where Omega reaches beyond the pieces that the bank was made of: its networks know nothing there."""
    if "bank" not in (config.source, config.rehearsal) and not config.correct:
        return
    for name, low, high in zip(model.PARAMETERS, *BANK_BOXES["wide"], strict=True):
        given = getattr(config, name, (low, high))  # the shapes are no option
        if given[0] < low or given[1] > high:
            raise BadInput(
                f"scooping, {name} = {list(given)}: the bank holds pieces of {low:g} to {high:g}; stay within, or use "
                "source = rehearsal = 'simulator', correct = false"
            )
