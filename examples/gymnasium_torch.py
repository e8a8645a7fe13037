"""Phase 1 over Gymnasium's MuJoCo and a network of torch: neither is known to JAX.

    pip install "gymnasium[mujoco]" torch
    python examples/gymnasium_torch.py runs/cart

A cart balances a pole. Omega: what the pole weighs, the slider's damping, the motor's gear. The
trainer is the cross-entropy method. The target is a cart outside of Omega, with a heavy pole.
"""

import sys

import gymnasium as gym
import numpy as np
import torch

from adaptsim_jax import HostSession, HostSimulation, Parameter, Space, train_host

SPACE = Space(
    (
        Parameter("pole", 3.0, 8.0, "kg"),
        Parameter("damping", 0.5, 3.0, "N s/m"),
        Parameter("gear", 50.0, 120.0),
    )
)
STEPS, SHOWN = 60, 6  # of an episode, and how many of its observations Phase 1 sees
ENV = gym.make("InvertedPendulum-v5", reset_noise_scale=0.1).unwrapped
NETWORK = torch.nn.Sequential(torch.nn.Linear(4, 1), torch.nn.Tanh())
SIZE = sum(p.numel() for p in NETWORK.parameters())


@torch.no_grad()
def episode(weights, parameters, seed):
    """Return and observations `[SHOWN * 4]` of one episode with these parameters."""
    torch.nn.utils.vector_to_parameters(torch.as_tensor(weights), NETWORK.parameters())
    mass, damping, gear = map(float, parameters)
    model = ENV.model
    model.body("pole").inertia *= mass / model.body("pole").mass
    model.body("pole").mass, model.dof_damping[0], model.actuator_gear[0, 0] = mass, damping, gear
    obs, seen, total = ENV.reset(seed=seed)[0], [], 0.0
    for step in range(STEPS):
        if step % (STEPS // SHOWN) == 0:
            seen.append(obs)
        action = 3.0 * NETWORK(torch.as_tensor(obs, dtype=torch.float32)).numpy()
        obs, _, fallen, _, _ = ENV.step(action)
        if fallen:  # as if it lay there until the end
            total -= 1.0 * (STEPS - step)
            break
        total -= obs[1] ** 2 + 0.1 * obs[0] ** 2 + 0.002 * float(action[0]) ** 2
    seen += [obs] * (SHOWN - len(seen))
    return total, np.concatenate(seen)


def train(ranges):
    """Weights that return most in simulators drawn from `ranges`."""
    rng = np.random.default_rng(0)
    low, high = np.array(list(ranges.values())).T
    mean, spread = np.zeros(SIZE), np.full(SIZE, 3.0)
    for generation in range(10):
        drawn = (mean + spread * rng.normal(size=(30, SIZE))).astype(np.float32)
        world = rng.uniform(low, high)
        returns = [episode(weights, world, generation)[0] for weights in drawn]
        best = drawn[np.argsort(returns)[-6:]]
        mean, spread = best.mean(0), best.std(0) + 0.05
    return {"weights": mean.astype(np.float32)}


def returns(policy, parameters, seed):
    """One episode of the policy in each of these simulators."""
    score, obs = zip(*(episode(policy["weights"], p, seed) for p in parameters), strict=True)
    return np.array(score), np.array(obs)


if __name__ == "__main__":
    run = train_host(HostSimulation(SPACE, train, returns), sys.argv[1])
    session, target = HostSession(run, starts=1, iterations=5), np.array([[9.0, 4.0, 60.0]])
    while not session.done:
        asked = session.ask()
        score, obs = returns(asked.policy, target, 1)
        best = session.tell(score[0], obs[0])
        print(f"trial {asked.trial}: {asked.params} returns {score[0]:.2f}{' *' * best}")
