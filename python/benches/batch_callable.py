"""Measures a campaign with crumple's policy, and with the same network as a batch callable in NumPy.

Run `RAYON_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benches/batch_callable.py` in the folder `python`.
"""

import json
import struct
import time
from pathlib import Path

import numpy as np

import crumple

POLICY = Path(__file__).parents[2] / "corpora/policy/reference.safetensors"


class Policy:
    """Policy file, evaluated in NumPy."""

    def __init__(self, path):
        data = path.read_bytes()
        (length,) = struct.unpack("<Q", data[:8])
        header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
        facts = json.loads(header.pop("__metadata__")["crumple_policy"])
        inputs, action = facts["observation"], facts["action"]
        self.offset, self.scale, self.limit = np.array(inputs["offset"]), np.array(inputs["scale"]), inputs["limit"]
        self.low_mps2, self.high_mps2 = action["low_mps2"], action["high_mps2"]
        self.interval_s = facts["decision_interval_s"]

        def tensor(name):
            begin, end = header[name]["data_offsets"]
            return np.frombuffer(body[begin:end], np.float32).reshape(header[name]["shape"])

        self.layers = [
            (tensor(f"actor.{i}.weight"), tensor(f"actor.{i}.bias")) for i in range(len(facts["hidden"]) + 1)
        ]

    def __call__(self, rows):
        """Returns accelerations for rows of observations."""
        x = ((rows - self.offset) / self.scale).clip(-self.limit, self.limit).astype(np.float32)
        for index, (weight, bias) in enumerate(self.layers):
            x = x @ weight + bias
            x = np.tanh(x) if index + 1 == len(self.layers) else np.maximum(x, 0.0)
        share = (x[:, 0].astype(np.float64) + 1.0) / 2.0
        return self.low_mps2 + share * (self.high_mps2 - self.low_mps2)


def time_campaign(controller):
    """Returns the shortest time of three campaigns, and the result of the last one."""
    best, found = float("inf"), None
    for _ in range(3):
        start_s = time.process_time()
        found = crumple.falsify(controller, "high-risk", method="uniform", budget=2000)
        best = min(best, time.process_time() - start_s)
    return best, found


def main():
    """Prints both times and their ratio."""
    policy = Policy(POLICY)
    inside, of_inside = time_campaign(str(POLICY))
    python, of_python = time_campaign(
        crumple.Controller(policy, batch=True, interval_s=policy.interval_s, name="numpy")
    )
    for name, time_s, found in (("inside crumple", inside, of_inside), ("batch callable", python, of_python)):
        failures = found.summary["methods"][0]["failures"]
        print(f"{name}: {time_s:.2f} s of processor time, {failures} failures of {found.summary['evaluations']}")
    print(f"ratio {python / inside:.2f}")


main()
