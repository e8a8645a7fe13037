"""Phase 1 of the pendulum as one would write it first: NumPy, SciPy and PyTorch, one trajectory
after another.

The peer of `benchmarks/phase1.py`. Same algorithm, sizes and ratios: solve_continuous_are and
solve_ivp for each adaptation step, a replay in NumPy arrays, 12 updates of batch 64 on a 128x128
branching dueling network for every 10 trajectories. One torch thread: at these sizes more threads
only cost.
"""

import os
import time

os.environ["OMP_NUM_THREADS"] = "1"  # as for torch below; set before NumPy loads its BLAS

import numpy as np
import torch
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are
from torch import nn

LOW, HIGH, DELTA, HORIZON = 1.0, 2.0, 0.1, 10
TIMES = np.linspace(0.0, 2.5, 1000)
START = np.array([-np.pi, 0.0, 0.0, 0.0])


def linear_model(params):
    m1, m2, b1, b2 = params
    inverse = np.linalg.inv(np.array([[m1 + 4 * m2, 2 * m2], [2 * m2, m2]]))
    gravity = 9.81 * np.array([[m1 + 2 * m2, m2], [m2, m2]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [inverse @ gravity, -inverse @ np.diag([b1, b2])]])
    return A, np.vstack([np.zeros((2, 2)), inverse])


def lqr(params):
    A, B = linear_model(params)
    return B.T @ solve_continuous_are(A, B, np.eye(4), np.eye(2))


def rollout(params, gain):
    """Cost over 1000 samples and the observation [24]."""
    A, B = linear_model(params)
    closed = A - B @ gain
    x = solve_ivp(lambda t, x: closed @ x, (0.0, 2.5), START, t_eval=TIMES).y.T
    u = x @ gain.T
    points = x[81:973:81, :2] * [1 / np.pi, 1.0] + [1.0, 0.0]
    return np.sum(x**2) + np.sum(u**2), points.reshape(-1)


class Network(nn.Module):
    def __init__(self, width=128):
        super().__init__()
        self.trunk = nn.Sequential(
            nn.Linear(28, width), nn.ELU(), nn.Linear(width, width), nn.ELU()
        )
        self.value, self.advantage = nn.Linear(width, 1), nn.Linear(width, 12)

    def forward(self, obs):
        h = self.trunk(obs)
        advantage = self.advantage(h).reshape(-1, 4, 3)
        return self.value(h)[:, :, None] + advantage - advantage.mean(2, keepdim=True)


class Replay:
    def __init__(self, capacity=10_000):
        self.obs, self.after = np.zeros((2, capacity, 28), np.float32)
        self.action = np.zeros((capacity, 4), np.int64)
        self.reward, self.more = np.zeros((2, capacity), np.float32)
        self.count = 0

    def add(self, *items):
        i = self.count % len(self.reward)
        self.obs[i], self.action[i], self.reward[i], self.after[i], self.more[i] = items
        self.count += 1

    def sample(self, rng, size):
        i = rng.integers(min(self.count, len(self.reward)), size=size)
        return [
            torch.from_numpy(x[i])
            for x in (self.obs, self.action, self.reward, self.after, self.more)
        ]


def update(online, target, adam, batch, discount=0.9, tau=0.01):
    obs, action, reward, after, more = batch
    with torch.no_grad():
        best = online(after).argmax(2, keepdim=True)
        wanted = reward + discount * more * target(after).gather(2, best)[..., 0].mean(1)
    q = online(obs).gather(2, action[..., None])[..., 0]
    loss = torch.mean((q - wanted[:, None]) ** 2)
    adam.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(online.parameters(), 1.0)
    adam.step()
    with torch.no_grad():
        for slow, fast in zip(target.parameters(), online.parameters(), strict=True):
            slow.lerp_(fast, tau)


def train(trajectories, seed=0, warmup=10):
    """Adaptation steps per second of wall time and of CPU time over `trajectories`, after `warmup`
    more.
    """
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    online, target = Network(), Network()
    target.load_state_dict(online.state_dict())
    adam = torch.optim.Adam(online.parameters(), 3e-4)
    replay = Replay()
    begin = cpu = 0.0
    for k in range(warmup + trajectories):
        if k == warmup:
            begin, cpu = time.perf_counter(), time.process_time()
        epsilon = max(0.1, 1.0 - k / (0.8 * (warmup + trajectories)))
        _one_trajectory(rng, online, replay, epsilon)
        if k % 10 == 9:
            for _ in range(12):
                update(online, target, adam, replay.sample(rng, 64))
    steps = trajectories * HORIZON
    return steps / (time.perf_counter() - begin), steps / (time.process_time() - cpu)


def _one_trajectory(rng, online, replay, epsilon):
    target_params, mean = rng.uniform(LOW, HIGH, (2, 4))
    best, _ = rollout(target_params, lqr(target_params))
    _, seen = rollout(target_params, lqr(mean))
    for i in range(HORIZON):
        obs = np.concatenate([2 * (mean - LOW) / (HIGH - LOW) - 1, seen]).astype(np.float32)
        if rng.uniform() < epsilon:
            action = rng.integers(3, size=4)
        else:
            with torch.no_grad():
                action = online(torch.from_numpy(obs)[None])[0].argmax(1).numpy()
        mean = np.clip(mean + np.array([-DELTA, DELTA, 0.0])[action] * (HIGH - LOW), LOW, HIGH)
        cost, seen = rollout(target_params, lqr(mean))
        after = np.concatenate([2 * (mean - LOW) / (HIGH - LOW) - 1, seen]).astype(np.float32)
        replay.add(obs, action, max(0.0, 1 - 10 * (cost / best - 1)), after, float(i < HORIZON - 1))


if __name__ == "__main__":
    print(*train(100))
