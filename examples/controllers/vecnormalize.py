"""Prints the tables `[[inputs]]` of a controller file from the statistics that `VecNormalize.save` wrote.

    python vecnormalize.py vecnormalize.pkl

Needs stable-baselines3. Fill in the quantities in the order of the observation, and set `normalised = true`;
docs/controllers.md describes both.
"""

import pickle
import sys

statistics = pickle.load(open(sys.argv[1], "rb"))
for mean, variance in zip(statistics.obs_rms.mean, statistics.obs_rms.var):
    scale = (variance + statistics.epsilon) ** 0.5
    print(f'[[inputs]]\nquantity = "?"\noffset = {mean}\nscale = {scale}')
    print(f"low = {-statistics.clip_obs}\nhigh = {statistics.clip_obs}\n")
