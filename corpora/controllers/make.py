"""Generates the networks of this folder, with their outputs in onnxruntime and Stable-Baselines3.

    python make.py networks      # ONNX networks; needs numpy, onnx, onnxruntime
    python make.py models        # models of Stable-Baselines3; needs torch, stable-baselines3
    python make.py normalised    # a model with VecNormalize and its statistics; needs the same
    python make.py oracle DIR    # 100 000 observations of each, for the ignored test `networks_agree_with_their_makers`

README.md lists the versions that generated the committed files.
"""

import json
import pathlib
import struct
import sys

import numpy as np

HERE = pathlib.Path(__file__).parent
FEW, MANY = 16, 100_000


# ONNX -----------------------------------------------------------------------------------------------------------------


class Graph:
    """Graph of ONNX nodes in a chain."""

    def __init__(self, shape, kind=np.float32, seed=0):
        self.shape, self.kind = shape, kind
        self.rng = np.random.default_rng(seed)
        self.nodes, self.constants, self.now = [], [], "x"

    def constant(self, array, as_floats=False):
        from onnx import helper, numpy_helper

        name = f"c{len(self.constants)}"
        array = np.asarray(array)
        array = array.astype(self.kind) if array.dtype.kind == "f" else array
        if as_floats:
            self.constants.append(helper.make_tensor(name, 1, array.shape, array.flatten().tolist()))
        else:
            self.constants.append(numpy_helper.from_array(array, name))
        return name

    def then(self, operator, *inputs, **attributes):
        from onnx import helper

        name = f"h{len(self.nodes)}"
        inputs = [self.now if name is None else name for name in inputs or (None,)]
        self.nodes.append(
            helper.make_node(operator, inputs, [name], name=f"{operator}_{len(self.nodes)}", **attributes)
        )
        self.now = name
        return self

    def weights(self, inputs, outputs):
        return self.rng.normal(0, 1.5 / np.sqrt(inputs), (inputs, outputs)), self.rng.normal(0, 0.3, outputs)

    def gemm(self, inputs, outputs, as_floats=False, **attributes):
        w, b = self.weights(inputs, outputs)
        w = w.T if attributes.get("transB") else w
        return self.then("Gemm", None, self.constant(w, as_floats), self.constant(b, as_floats), **attributes)

    def matmul(self, inputs, outputs):
        w, b = self.weights(inputs, outputs)
        return self.then("MatMul", None, self.constant(w)).then("Add", None, self.constant(b))

    def bytes(self, opset, outputs):
        from onnx import TensorProto, helper

        number = TensorProto.DOUBLE if self.kind == np.float64 else TensorProto.FLOAT
        graph = helper.make_graph(
            self.nodes,
            "network",
            [helper.make_tensor_value_info("x", number, self.shape)],
            [helper.make_tensor_value_info(self.now, number, outputs)],
            self.constants,
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=4)
        return model.SerializeToString()


def reference():
    """Converts crumple's reference policy: three layers of 64 with ReLU, and tanh."""
    raw = (HERE / "../policy/reference.safetensors").read_bytes()
    (size,) = struct.unpack("<Q", raw[:8])
    header, data = json.loads(raw[8 : 8 + size]), raw[8 + size :]

    def tensor(name):
        begin, end = header[name]["data_offsets"]
        return np.frombuffer(data[begin:end], "<f4").reshape(header[name]["shape"])

    g = Graph(["N", 8])
    for layer in range(4):
        g.then("Gemm", None, g.constant(tensor(f"actor.{layer}.weight")), g.constant(tensor(f"actor.{layer}.bias")))
        g.then("Relu" if layer < 3 else "Tanh")
    return g.bytes(13, ["N", 1])


def imitation(is_old):
    """Returns an adaptive cruise controller with the architecture of the ARCH benchmark.

    Five layers of 20 follow the inputs (set speed, time gap, own speed, distance, relative speed), each minus 1. Least
    squares on the last layer imitate an expert policy.
    """
    rng = np.random.default_rng(20)
    n = 20_000
    speed, gap, relative = rng.uniform(0, 36, n), rng.uniform(0, 160, n), rng.uniform(-12, 12, n)
    samples = np.stack([np.full(n, 30.0), np.full(n, 1.4), speed, gap, relative], 1)
    expert = np.minimum(0.4 * (30.0 - speed), 0.25 * (gap - 10.0 - 1.4 * speed) + 0.9 * relative).clip(-7.5, 3.0)
    scale = np.array([30.0, 1.4, 18.0, 80.0, 6.0])
    h, layers = (samples - 1.0).astype(np.float64), []
    for index, (width, before) in enumerate([(20, 5)] + [(20, 20)] * 4):
        w = rng.normal(0, np.sqrt(2 / before), (before, width))
        w = w / scale[:, None] if index == 0 else w
        b = rng.normal(0, 0.3, width)
        layers.append((w, b))
        h = np.maximum(h @ w + b, 0)
    last, *_ = np.linalg.lstsq(np.c_[h, np.ones(n)], expert, rcond=None)
    layers.append((last[:-1, None], last[-1:]))
    g = Graph([1, 1, 1, 5] if is_old else [1, 5])
    g.then("Sub", None, g.constant(np.ones((1, 1, 1, 5) if is_old else 5)))
    for index, (w, b) in enumerate(layers):
        g.then("Gemm", None, g.constant(w), g.constant(b), **({"broadcast": 1} if is_old else {}))
        if index < 5:
            g.then("Relu")
    return g.bytes(6 if is_old else 13, [1, 1])


def shapes():
    """Yields the name, the number of inputs and the file of ten networks with different architectures."""
    g = Graph(["N", 8], seed=1)
    g.gemm(8, 33, transB=1).then("Tanh").gemm(33, 17, transB=1).then("Tanh").gemm(17, 1, transB=1).then("Tanh")
    yield "tanh-33-17", 8, g.bytes(13, ["N", 1])
    g = Graph(["N", 8], seed=2)
    g.matmul(8, 40).then("LeakyRelu", alpha=0.1).matmul(40, 1)
    g.then("Clip", None, g.constant(-1.0), g.constant(1.0))
    yield "leaky-40-clip", 8, g.bytes(11, ["N", 1])
    g = Graph(["N", 12], np.float64, seed=3)
    g.gemm(12, 16).then("Sigmoid").gemm(16, 16).then("Sigmoid").gemm(16, 2)
    yield "sigmoid-double", 12, g.bytes(13, ["N", 2])
    g = Graph(["N", 8], seed=4)
    g.then("Sub", None, g.constant(g.rng.normal(20, 10, 8))).then("Div", None, g.constant(g.rng.uniform(2, 9, 8)))
    g.gemm(8, 64).then("Relu").gemm(64, 64).then("Relu").gemm(64, 64).then("Relu").gemm(64, 1).then("Tanh")
    yield "normalised-64-64-64", 8, g.bytes(9, ["N", 1])
    g = Graph(["N", 1, 3], seed=5)
    g.then("Reshape", None, g.constant(np.array([-1, 3]))).gemm(3, 7).then("Elu", alpha=0.7).gemm(7, 5)
    g.then("Elu").gemm(5, 4)
    yield "elu-7-5", 3, g.bytes(8, ["N", 4])
    g = Graph([8, 1], seed=6)
    for inputs, outputs in [(8, 24), (24, 1)]:
        w, b = g.weights(inputs, outputs)
        g.then("MatMul", g.constant(w.T), None).then("Add", g.constant(b[:, None]), None).then("Tanh")
    yield "columns-24", 8, g.bytes(13, [1, 1])
    g = Graph(["N", 2, 4, 3], seed=7)
    g.then("Flatten").gemm(24, 30).then("Relu").then("Identity").gemm(30, 1).then("Sigmoid")
    yield "flattened-30", 24, g.bytes(11, ["N", 1])
    g = Graph(["N", 8], seed=8)
    g.gemm(8, 50, alpha=0.5, beta=2.0).then("Relu").matmul(50, 25).then("Tanh").then("Mul", None, g.constant(1.5))
    g.then("Add", None, g.constant(-0.25)).gemm(25, 1).then("Clip", min=-2.0, max=0.5)
    yield "mixed-50-25", 8, g.bytes(9, ["N", 1])
    g = Graph(["N", 6], seed=9)
    g.gemm(6, 100, as_floats=True).then("Relu").gemm(100, 1, as_floats=True)
    g.then("Sub", g.constant(0.5), None)
    yield "floats-100", 6, g.bytes(13, ["N", 1])
    g = Graph(["N", 8], seed=10)
    g.gemm(8, 5).then("Relu").gemm(5, 48).then("Sigmoid").gemm(48, 3).then("Relu").gemm(3, 1).then("Tanh")
    yield "bottleneck", 8, g.bytes(13, ["N", 1])


def observations(count, inputs):
    """Returns random observations."""
    return (np.random.default_rng(inputs + count).normal(0, 1, (count, inputs)) * 2).astype(np.float32)


def onnx_answers(model, samples):
    """Returns the outputs of onnxruntime; evaluates observations singly if the batch size is fixed."""
    import onnxruntime

    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    (x,) = session.get_inputs()
    kind = np.float64 if "double" in x.type else np.float32
    if isinstance(x.shape[0], str):
        return session.run(None, {x.name: samples.astype(kind).reshape(-1, *x.shape[1:])})[0].reshape(len(samples), -1)
    return np.array([session.run(None, {x.name: row.astype(kind).reshape(x.shape)})[0].flatten() for row in samples])


def write_expected(file, pairs):
    """Writes observations and answers with all digits."""
    path = HERE / file
    rounded = {name: {"inputs": x.tolist(), "answers": y.astype(np.float64).tolist()} for name, (x, y) in pairs.items()}
    path.write_text(json.dumps(rounded, separators=(",", ":")).replace('},"', '},\n"') + "\n")


def networks():
    """Writes the ONNX networks."""
    (HERE / "reference.onnx").write_bytes(reference())
    (HERE / "acc-5x20.onnx").write_bytes(imitation(is_old=True))
    pairs = {}
    samples = observations(FEW, 5) * [1, 0.1, 9, 40, 3] + np.float32([30, 1.4, 18, 80, 0])
    samples = samples.astype(np.float32)
    pairs["acc-5x20.onnx"] = samples, onnx_answers(imitation(is_old=False), samples)
    for name, inputs, model in shapes():
        (HERE / f"{name}.onnx").write_bytes(model)
        pairs[f"{name}.onnx"] = observations(FEW, inputs), onnx_answers(model, observations(FEW, inputs))
    write_expected("networks.json", pairs)


# Stable-Baselines3 ----------------------------------------------------------------------------------------------------


def untrained_models():
    """Yields the name, the model and the training steps of six models for a small environment."""
    import gymnasium
    import torch
    from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3

    class Keep(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-4, 4, (8,), np.float32)

        def __init__(self, low=-1.0, high=1.0):
            self.action_space = gymnasium.spaces.Box(low, high, (1,), np.float32)

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.state = self.np_random.uniform(-1, 1, 8).astype(np.float32)
            return self.state, {}

        def step(self, action):
            self.state = (0.9 * np.roll(self.state, 1) + 0.1 * float(action[0])).astype(np.float32)
            return self.state, -float(np.abs(self.state).sum()), False, bool(self.np_random.random() < 0.05), {}

    torch.manual_seed(0)
    small = {"net_arch": [16, 8]}
    late = {"learning_starts": 20, "buffer_size": 200, "batch_size": 16, "seed": 0, "verbose": 0}
    yield "ppo", PPO("MlpPolicy", Keep(), n_steps=64, batch_size=32, n_epochs=2, seed=0, policy_kwargs=dict(small)), 128
    yield "a2c", A2C("MlpPolicy", Keep(-7.5, 3.0), seed=0, policy_kwargs=small | {"activation_fn": torch.nn.ReLU}), 50
    yield "sac", SAC("MlpPolicy", Keep(-7.5, 3.0), policy_kwargs=dict(small), **late), 60
    yield "sac-gsde", SAC("MlpPolicy", Keep(), use_sde=True, policy_kwargs=dict(small), **late), 60
    yield "td3", TD3("MlpPolicy", Keep(), policy_kwargs=small | {"activation_fn": torch.nn.ELU}, **late), 60
    yield "ddpg", DDPG("MlpPolicy", Keep(-2.0, 2.0), policy_kwargs=dict(small), **late), 60


def models():
    """Writes the models of Stable-Baselines3."""
    pairs = {}
    for name, model, steps in untrained_models():
        model.learn(steps)
        model.save(HERE / f"{name}.zip")
        samples = observations(FEW, 8)
        pairs[f"{name}.zip"] = samples, model.predict(samples, deterministic=True)[0]
    write_expected("models.json", pairs)


def normalised():
    """Writes a model with VecNormalize, without unused parts, and its statistics with and without observations."""
    import zipfile

    import gymnasium
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    class Follow(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)
        action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.state = self.np_random.uniform([5, 5, -3], [50, 30, 3])
            return self.state.astype(np.float32), {}

        def step(self, action):
            acceleration = 3 * float(action[0]) - 1
            self.state += [0.1 * self.state[2], 0.1 * acceleration, -0.1 * acceleration]
            gap, speed, _ = self.state
            return (
                self.state.astype(np.float32),
                -abs(gap - 4 - 1.4 * speed) / 20,
                False,
                bool(self.np_random.random() < 0.05),
                {},
            )

    folder = HERE / "normalised"
    folder.mkdir(exist_ok=True)
    torch.manual_seed(0)
    env = VecNormalize(DummyVecEnv([Follow]), clip_obs=5.0)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=32, n_epochs=2, seed=0, policy_kwargs={"net_arch": [4]})
    model.learn(128)
    model.save(folder / "whole.zip")
    with zipfile.ZipFile(folder / "whole.zip") as whole, zipfile.ZipFile(folder / "ppo.zip", "w") as small:
        for name in ["data", "policy.pth", "_stable_baselines3_version"]:
            small.writestr(name, whole.read(name))
    (folder / "whole.zip").unlink()
    env.save(folder / "ppo_vecnormalize.pkl")
    env.norm_obs = False
    env.save(folder / "rewards-alone.pkl")
    env.norm_obs = True
    env.training = False
    samples = (observations(FEW, 3) * [20, 5, 2] + [25, 15, 0]).astype(np.float32)
    answers = model.predict(env.normalize_obs(samples), deterministic=True)[0]
    (folder / "answers.json").write_text(
        json.dumps({"seen": samples.tolist(), "answers": answers.astype(np.float64).tolist()}) + "\n"
    )
    quantities = ["gap_ahead_m", "speed_mps", "relative_speed_ahead_mps"]
    text = 'version = 1\nnetwork = "ppo.zip"\ndecision_interval_s = 0.1\nnormalised = true\n'
    for quantity, mean, variance in zip(quantities, env.obs_rms.mean, env.obs_rms.var):
        scale = float(np.sqrt(variance + env.epsilon))
        text += f'\n[[inputs]]\nquantity = "{quantity}"\noffset = {float(mean)}\nscale = {scale}\n'
        text += f"low = {-env.clip_obs}\nhigh = {env.clip_obs}\n"
    text += "\n[output]\nscale_mps2 = 3.0\noffset_mps2 = -1.0\nlow_mps2 = -4.0\nhigh_mps2 = 2.0\n"
    (folder / "ppo.toml").write_text(text)


# Oracle ---------------------------------------------------------------------------------------------------------------


def oracle(folder):
    """Writes observations and answers in single precision beside a copy of each network."""
    from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3

    folder.mkdir(parents=True, exist_ok=True)
    kinds = {"ppo": PPO, "a2c": A2C, "sac": SAC, "sac-gsde": SAC, "td3": TD3, "ddpg": DDPG}

    def put(file, samples, answers):
        (folder / file).write_bytes((HERE / file).read_bytes())
        (folder / f"{file}.inputs").write_bytes(samples.astype("<f4").tobytes())
        (folder / f"{file}.answers").write_bytes(answers.astype("<f4").tobytes())

    for name, inputs, model in shapes():
        samples = observations(MANY, inputs)
        put(f"{name}.onnx", samples, onnx_answers(model, samples))
    for name, kind in kinds.items():
        samples = observations(10_000, 8)
        put(f"{name}.zip", samples, kind.load(HERE / f"{name}.zip").predict(samples, deterministic=True)[0])


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["networks"]:
            networks()
        case ["models"]:
            models()
        case ["normalised"]:
            normalised()
        case ["oracle", folder]:
            oracle(pathlib.Path(folder))
        case _:
            sys.exit(__doc__)
