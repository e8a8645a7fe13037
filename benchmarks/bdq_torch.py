"""Updates of BDQ networks one after another in PyTorch, the peer of `benchmarks/table.py`: the
network and the update of `phase1_torch.py`, one torch thread. Prints updates per second of wall
time.
"""

import argparse
import time

import torch
from phase1_torch import Network, update


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--policies", type=int, default=16)
    parser.add_argument("--batch", type=int, default=64)
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    pairs = [(Network(), Network()) for _ in range(args.policies)]
    adams = [torch.optim.Adam(online.parameters(), 3e-4) for online, _ in pairs]
    batch = [
        torch.randn(args.batch, 28),
        torch.randint(3, (args.batch, 4)),
        torch.rand(args.batch),
        torch.randn(args.batch, 28),
        torch.ones(args.batch),
    ]
    for (online, target), adam in zip(
        pairs, adams, strict=True
    ):  # the first update makes Adam's buffers
        update(online, target, adam, batch)
    done, begin = 0, time.perf_counter()
    while time.perf_counter() - begin < 2.0:
        for (online, target), adam in zip(pairs, adams, strict=True):
            update(online, target, adam, batch)
        done += args.policies
    print(done / (time.perf_counter() - begin))


if __name__ == "__main__":
    main()
