"""Trains and exports a PyTorch network as a controller, with crumple's eight inputs and an output from -1 to 1.

    python export_onnx.py follower.onnx
    crumple simulate paper-1 --controller follower.onnx

Needs torch, onnx and onnxscript. docs/controllers.md describes the inputs, and how to choose other ones.
"""

import sys

import torch
from torch import nn

# Gaps ahead and behind; speeds of leader, own vehicle and follower; their accelerations. Each input is
# (x - offset) / scale, clipped to +-4.
OFFSET = torch.tensor([16.0, 16.0, 12.5, 12.5, 12.5, 0.0, 0.0, 0.0])
SCALE = torch.tensor([16.0, 16.0, 12.5, 12.5, 12.5, 5.0, 5.0, 5.0])


def target_command(inputs):
    """Returns the expert's outputs: keeps 5 m and 1.5 s to the leader. -1 is -7.5 m/s², 1 is 3 m/s²."""
    x = inputs * SCALE + OFFSET
    target_mps2 = 0.3 * (x[:, 0] - 5.0 - 1.5 * x[:, 3]) + 1.0 * (x[:, 2] - x[:, 3]) + 0.6 * x[:, 5]
    return ((target_mps2 + 2.25) / 5.25).clamp(-1, 1).unsqueeze(1)


torch.manual_seed(0)
network = nn.Sequential(nn.Linear(8, 32), nn.Tanh(), nn.Linear(32, 32), nn.Tanh(), nn.Linear(32, 1), nn.Tanh())
optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
for _ in range(2000):
    inputs = torch.rand(512, 8) * torch.tensor([5.0, 5.0, 2, 2, 2, 2, 2, 2]) - 1.0
    loss = (network(inputs) - target_command(inputs)).pow(2).mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
# In one file: by default PyTorch writes the weights to a second one.
torch.onnx.export(network, (torch.zeros(1, 8),), sys.argv[1], dynamo=True, external_data=False, verbose=False)
