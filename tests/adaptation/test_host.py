"""Phase 1 from the host is the compiled one where both are told the same; cut anywhere it gives the
same bits.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax import HostSession, HostSimulation, TrainConfig, make_phase1, train_host
from adaptsim_jax.adaptation.phase1_config import Phase1Config
from adaptsim_jax.adaptation.reuse import ReuseConfig, empty_pool
from adaptsim_jax.adaptation.training import traced
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.base import scaled_reward
from tests.adaptation.toy import make_toy

SIZES = Phase1Config(
    trajectories=12,
    parallel=4,
    horizon=3,
    updates=4,
    batch=8,
    capacity=36,
    archive=36,
    hidden=(16,),
    reuse=ReuseConfig(threshold=0.2, capacity=64),
)
CONFIG = TrainConfig(seed=2, every=1, phase1=SIZES)
TOY = make_toy()


class Toy:
    """The toy's task in NumPy, as anyone's functions; how often they were called, and an
    interruption.
    """

    def __init__(self, stop_at: int = -1):
        self.trained, self.tried, self.stop_at = 0, 0, stop_at

    def train(self, ranges):
        self.trained += 1
        return {"at": np.array([(low + high) / 2 for low, high in ranges.values()], np.float32)}

    def returns(self, policy, parameters, seed):
        self.tried += 1
        if self.tried == self.stop_at:
            raise KeyboardInterrupt
        gap = (parameters - policy["at"]) / 2
        return -np.linalg.norm(gap, axis=1), np.concatenate([2 * gap, np.ones((len(gap), 1))], 1)

    def simulation(self, **changed):
        given = {"spread": 0.0, "references": 4, **changed}
        return HostSimulation(TOY.space, self.train, self.returns, **given)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    toy = Toy()
    folder = tmp_path_factory.mktemp("host") / "run"
    return toy, folder, train_host(toy.simulation(), folder, CONFIG)


def compiled_of(run):
    """The same problem with the same rewards, observations and first anchors, in one program."""
    means, shown = jnp.asarray(run.theirs.references), run.theirs._shown

    def bounds(params):
        scores = jax.vmap(lambda mean: TOY.score(TOY.rollout(None, mean, params)))(means)
        return jnp.stack([scores.max(), scores.mean()])

    def observe(gap):
        obs = (jnp.append(TOY.observe(gap), 1.0) - shown["mean"]) / shown["spread"]
        return jnp.clip(obs, -10.0, 10.0)

    task = replace(
        TOY,
        train_many=lambda keys, dists, policies, trials: jnp.where(
            trials[:, None] > 0, dists.mean, policies
        ),
        observe=observe,
        obs_dim=3,
        reference=bounds,
        reward=lambda gap, of: scaled_reward(TOY.score(gap), of),
    )
    once = replace(SIZES.reuse, first=1, most=1, least=1, together=1)
    phase1 = make_phase1(task, replace(SIZES, reuse=once))
    pool, n = empty_pool(once, 2, means[0]), len(means)
    pool = pool._replace(
        mean=pool.mean.at[:n].set(means),
        policy=pool.policy.at[:n].set(means),
        taught=pool.taught.at[:n].set(1),
        spent=pool.spent.at[:n].set(1),
        count=jnp.int32(n),
    )
    state = phase1.init(jax.random.key(CONFIG.seed))._replace(pool=pool)
    return jax.jit(phase1.run)(state, traced(CONFIG.hyper), jnp.arange(3))


def test_it_is_the_compiled_phase_1(whole):
    _, _, run = whole
    state, info = compiled_of(run)
    ours = run.trained.state
    # products of batches are summed in another order, which rounds
    np.testing.assert_allclose(ours.archive.mean, state.archive.mean, atol=1e-6)
    np.testing.assert_array_equal(ours.replay.action, state.replay.action)
    np.testing.assert_allclose(ours.replay.obs, state.replay.obs, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(ours.replay.reward, state.replay.reward, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(ours.learner.online, state.learner.online, rtol=1e-3, atol=1e-5)
    assert int(ours.pool.count) == int(state.pool.count) > 4
    assert np.asarray(info.reused).mean() > 0  # lent, and trained anew


def test_a_killed_run_goes_on_to_the_same_bits(whole, tmp_path):
    uncut, _, run = whole
    for stop_at in (3, uncut.tried // 2):  # before the first round, and within one
        killed, again = Toy(stop_at), Toy()
        folder = tmp_path / str(stop_at)
        with pytest.raises(KeyboardInterrupt):
            train_host(killed.simulation(), folder, CONFIG)
        after = train_host(again.simulation(), folder, CONFIG)
        leaves = [jax.tree.leaves(r.trained.state._replace(key=None)) for r in (after, run)]
        assert all(
            np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in zip(*leaves, strict=True)
        )
        # what was trained before is not trained again
        assert killed.trained + again.trained == uncut.trained and killed.trained > 0


def test_a_finished_run_is_read_and_adapts(whole, capsys):
    _, folder, _ = whole
    toy = Toy()
    run = train_host(toy.simulation(), folder, CONFIG)
    said = capsys.readouterr().out
    assert toy.trained == toy.tried == 0 and "% of the time in your functions" in said
    assert 0.0 < sum(run.share.values()) <= 1.0
    target, told = np.array([[2.7, 1.2]], np.float32), []
    session = HostSession(run, starts=1, iterations=2)
    while not session.done:
        asked = session.ask()
        score, obs = toy.returns(asked.policy, target, 0)
        told.append((score[0], asked.policy["at"]))
        session.tell(score[0], obs[0])
    best = max(told, key=lambda pair: pair[0])
    np.testing.assert_array_equal(session.best().policy["at"], best[1])
    assert len(told) == 3


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"returns": lambda p, x, s: (np.zeros(len(x) + 1), np.zeros((len(x), 2)))}, "simulators"),
        ({"returns": lambda p, x, s: (np.zeros(len(x)), np.full((len(x), 2), np.nan))}, "finite"),
        ({"train": lambda ranges: None}, "{name: array}"),
        ({"references": 0}, "references"),
    ],
)
def test_what_the_functions_give_is_checked(tmp_path, changed, says):
    with pytest.raises(BadInput, match=says):
        train_host(replace(Toy().simulation(), **changed), tmp_path / "run", CONFIG)
