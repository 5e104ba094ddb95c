"""Training of policies."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, overload

from crumple._crumple import train as _train
from crumple._executor import Executor
from crumple._numbers import whole_number
from crumple._seeds import read_seeds, run_seeds
from crumple._simulate import Progress
from crumple.errors import TrainingError


@dataclass(frozen=True)
class Training:
    """Result of the training of one seed."""

    result: dict[str, Any] = field(repr=False)
    """Content of ``result.json``: measures of the best policy on the validation set, and the digest of the policy."""
    policy: bytes | None = field(repr=False)
    """Content of ``policy.safetensors``; None if no policy was better than the untrained network."""
    text: str = field(repr=False)
    """Output of ``crumple train``: a table with one row."""

    @property
    def seed(self) -> int:
        """The seed."""
        return int(self.result["seed"])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the policy to a file that ends in ``.safetensors``: a controller of every function."""
        if Path(path).suffix != ".safetensors":
            raise TrainingError(f"{os.fspath(path)}: a policy is saved as .safetensors", os.fspath(path))
        if self.policy is None:
            raise TrainingError(f"seed {self.seed} learned nothing, so there is no policy")
        Path(path).write_bytes(self.policy)

    def __str__(self) -> str:
        return self.text


@overload
def train(
    preset: str | os.PathLike[str] = ...,
    seed: int = ...,
    out: str | os.PathLike[str] | None = ...,
    *,
    spaces: Iterable[str] | Mapping[str, float] = ...,
    episodes: int | None = ...,
    resume: bool = ...,
    threads: int | None = ...,
    executor: Executor | None = ...,
    progress: Progress | None = ...,
) -> Training: ...


@overload
def train(
    preset: str | os.PathLike[str] = ...,
    seed: Iterable[int] = ...,
    out: str | os.PathLike[str] | None = ...,
    *,
    spaces: Iterable[str] | Mapping[str, float] = ...,
    episodes: int | None = ...,
    resume: bool = ...,
    threads: int | None = ...,
    executor: Executor | None = ...,
    progress: Progress | None = ...,
) -> list[Training]: ...


def train(
    preset: str | os.PathLike[str] = "fast",
    seed: int | Iterable[int] = 0,
    out: str | os.PathLike[str] | None = None,
    *,
    spaces: Iterable[str] | Mapping[str, float] = (),
    episodes: int | None = None,
    resume: bool = False,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Training | list[Training]:
    """Trains a policy, as ``crumple train`` does, with the same bytes.

    ``preset`` is a name, a path, or a text of TOML (of two lines at least) like that of :func:`training_preset`.
    ``spaces`` replaces its spaces: names or files, or a dictionary with their weights. ``episodes`` is the maximum
    number of episodes, 1 to 10 000 000. ``out`` is the folder of ``crumple train``: the training is in ``seed-N``, and
    ``resume`` continues it. ``crumple train --resume`` summarises the trainings in ``out``. Without ``out`` only the
    result remains.

    ``progress`` is called with the numbers of completed episodes, of all episodes, and of evaluations that found a
    better policy. An exception in it, and Ctrl-C, end the training.

    With several seeds, ``train`` returns the training of each, one after the other. ``executor`` runs each as one task,
    and ``progress`` then receives numbers of trainings, the last one of those that learned something; ``out`` must be a
    folder that all workers share. ``threads`` and ``executor`` are those of :func:`crumple.simulate`.
    """
    is_single = not isinstance(seed, Iterable)
    seeds = read_seeds(seed, 2**64 - 1, TrainingError)
    if episodes is not None:
        episodes = whole_number("episodes", episodes, 1, 10_000_000, TrainingError)
    shares = list(spaces.items()) if isinstance(spaces, Mapping) else [(space, 1.0) for space in spaces]
    options = (os.fspath(preset), None if out is None else Path(out), shares, episodes, resume, threads)
    arguments = [(each, *options) for each in seeds]
    trained = run_seeds(_train_seed, seeds, arguments, executor, progress, lambda each: each.policy is not None)
    return trained[0] if is_single else trained


def _train_seed(
    seed: int,
    preset: str,
    out: Path | None,
    spaces: list[tuple[str, float]],
    episodes: int | None,
    resume: bool,
    threads: int | None,
    progress: Progress | None,
) -> Training:
    if out is None:
        with tempfile.TemporaryDirectory(prefix="crumple-") as temporary:
            return _train_seed(seed, preset, Path(temporary), spaces, episodes, resume, threads, progress)
    result, text = _train(preset, seed, out, spaces, episodes, resume, threads, progress)
    policy = out / f"seed-{seed}" / "policy.safetensors"
    return Training(result, policy.read_bytes() if policy.exists() else None, text)
