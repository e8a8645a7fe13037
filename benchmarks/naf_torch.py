"""NAF as one would write it first in PyTorch: an object for each policy, updated in a loop.

The peer of `benchmarks/naf.py`. Same network, full P = L L', loss, clipping and Adam; batches are
drawn beforehand on both sides. One torch thread unless asked otherwise: at these sizes more threads
only cost. Prints updates per second of wall time and of CPU time.
"""

import argparse
import os
import time

parser = argparse.ArgumentParser()
parser.add_argument("--policies", type=int, default=256)
parser.add_argument("--rounds", type=int, default=4, help="updates of every policy")
parser.add_argument("--batch", type=int, default=64)
parser.add_argument("--width", type=int, default=64)
parser.add_argument("--threads", type=int, default=1)
args = parser.parse_args()
os.environ["OMP_NUM_THREADS"] = str(args.threads)

import torch  # noqa: E402
from torch import nn  # noqa: E402


class NAF(nn.Module):
    def __init__(self, width, obs=2, actions=2):
        super().__init__()
        self.trunk = nn.Sequential(
            nn.Linear(obs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.heads = nn.Linear(width, 1 + actions + actions * (actions + 1) // 2)
        self.actions = actions
        self.rows, self.columns = torch.tril_indices(actions, actions)
        self.diagonal = self.rows == self.columns

    def forward(self, obs, action):
        heads = self.heads(self.trunk(obs))
        value, mean, entries = (
            heads[:, 0],
            1.5 * torch.tanh(heads[:, 1 : 1 + self.actions]),
            heads[:, 1 + self.actions :],
        )
        entries = torch.where(self.diagonal, torch.exp(2.0 * torch.tanh(entries)), entries)
        chol = entries.new_zeros(len(obs), self.actions, self.actions)
        chol[:, self.rows, self.columns] = entries
        stretched = torch.bmm((action - mean)[:, None], chol)[:, 0]
        return value - 0.5 * torch.sum(stretched**2, 1)


def update(net, adam, obs, action, reward):
    loss = nn.functional.smooth_l1_loss(net(obs, action), reward)
    adam.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(net.parameters(), 1.0)
    adam.step()


def main():
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    nets = [NAF(args.width) for _ in range(args.policies)]
    adams = [torch.optim.Adam(net.parameters(), 1e-3) for net in nets]
    batches = [
        (torch.randn(args.batch, 2), torch.rand(args.batch, 2) * 2 - 1, torch.rand(args.batch))
        for _ in range(args.rounds)
    ]
    for net, adam in zip(nets, adams, strict=True):  # the first update makes Adam's buffers
        update(net, adam, *batches[0])
    begin, cpu = time.perf_counter(), time.process_time()
    for batch in batches:
        for net, adam in zip(nets, adams, strict=True):
            update(net, adam, *batch)
    done = args.policies * args.rounds
    print(done / (time.perf_counter() - begin), done / (time.process_time() - cpu))


if __name__ == "__main__":
    main()
