#!/usr/bin/env python3
"""Writes MDF 4 files with asammdf, DBC files with cantools, and the values that these tools read from them."""

import json
import random
import struct
import sys
from pathlib import Path

import cantools
import numpy as np
from asammdf import MDF, Signal, Source
from asammdf.blocks import v4_constants as v4
from cantools.database.can import Database, Message
from cantools.database.can import Signal as CanSignal
from cantools.database.conversion import BaseConversion


def bits(values):
    return [struct.pack(">d", float(value)).hex() for value in values]


def conversion(rng, is_float):
    kind = rng.choice(["none", "linear", "rational", "table", "interpolated", "ranges"])
    number = lambda: rng.choice([0.01, 0.1, 0.25, 1.0, 3.6, -0.5, rng.uniform(-50, 50)])
    if kind == "linear":
        return {"a": number(), "b": rng.choice([0.0, number()])}
    # asammdf computes other rational functions with integers, whose powers overflow.
    if kind == "rational" and not is_float:
        return {"P1": 0.0, "P2": number(), "P3": 0.0, "P4": 0.0, "P5": 0.0, "P6": 1.0}
    if kind in ("table", "interpolated"):
        keys = sorted(rng.sample(range(-200, 300), rng.randint(2, 6)))
        pairs = {f"raw_{index}": float(key) for index, key in enumerate(keys)}
        values = {f"phys_{index}": number() for index in range(len(keys))}
        return pairs | values | {"interpolation": kind == "interpolated"}
    # asammdf gives whole numbers between two ranges the value of the lower one, against the standard.
    if kind == "ranges" and is_float:
        edges = sorted(rng.sample(range(-200, 300), 4))
        ends = {"lower_0": edges[0], "upper_0": edges[1], "lower_1": edges[2], "upper_1": edges[3]}
        return ends | {"phys_0": number(), "phys_1": number(), "default": number()}
    return None


def write_channels(path, rng):
    """Several groups, each with its own clock. Returns the values by name."""
    mdf = MDF(version=rng.choice(["4.00", "4.10", "4.11", "4.20"]))
    names = []
    for group in range(rng.randint(1, 3)):
        count = rng.choice([1, 7, 100, 3000])
        step = rng.choice([0.01, 0.02, 0.1])
        times = np.arange(count) * step + rng.uniform(0, 5)
        signals = []
        for number in range(rng.randint(1, 5)):
            dtype = rng.choice(
                [
                    "<u1",
                    "<i1",
                    "<u2",
                    ">u2",
                    "<i2",
                    ">i2",
                    "<u4",
                    ">u4",
                    "<i4",
                    ">i4",
                    "<u8",
                    ">i8",
                    "<f4",
                    ">f4",
                    "<f8",
                    ">f8",
                ]
            )
            info = None if dtype[1] == "f" else np.iinfo(dtype)
            random_values = np.random.default_rng(rng.getrandbits(32))
            if info is None:
                values = random_values.normal(0, 40, count).astype(dtype)
            else:
                low, high = rng.choice([(info.min, info.max), (max(info.min, -100), min(info.max, 200))])
                values = random_values.integers(low, high, count, dtype=dtype[1:], endpoint=True).astype(dtype)
            name = f"channel_{group}_{number}"
            # asammdf multiplies numbers of 32 bits in single precision.
            chosen = None if dtype[1:] == "f4" else conversion(rng, info is None)
            # Numbers of 64 bits are as far from all keys of a table, up to rounding.
            if chosen and dtype[2] == "8" and info and "raw_0" in chosen:
                chosen = None
            bits_of = (
                rng.choice([None, 3, 11]) if info and info.bits >= 16 and info.min == 0 and dtype[0] == "<" else None
            )
            if bits_of:
                values = values & (2**bits_of - 1)
            invalid = None
            if rng.random() < 0.2:
                invalid = random_values.random(count) < 0.3
            signals.append(
                Signal(
                    values,
                    times,
                    name=name,
                    unit="m/s",
                    conversion=chosen,
                    invalidation_bits=invalid,
                    bit_count=bits_of,
                )
            )
            names.append(name)
        mdf.append(signals, common_timebase=True)
    mdf.save(path, compression=rng.choice([0, 1, 2]), overwrite=True)
    mdf.close()
    values = {}
    with MDF(path) as again:
        for name in names:
            signal = again.get(name, ignore_invalidation_bits=True)
            samples = signal.samples.astype("f8")
            if signal.invalidation_bits is not None:
                samples[np.asarray(signal.invalidation_bits)] = np.nan
            values[name] = {"times": bits(signal.timestamps), "values": bits(samples)}
    return values


def write_frames(path, rng):
    """Raw CAN frames with a DBC file. Returns the values by name."""
    messages, frames = [], []
    for number in range(rng.randint(1, 3)):
        is_extended = rng.random() < 0.3
        id_ = rng.choice([5, 0x123, 0x7FF]) + number if not is_extended else 0x18FEF100 + number
        id_ = min(id_, 0x7FF - number) if not is_extended else id_
        signals, used = [], set()
        multiplexed = rng.random() < 0.5
        if multiplexed:
            signals.append(CanSignal(f"mode_{number}", 0, 4, is_multiplexer=True))
            used |= set(range(4))
        for index in range(rng.randint(1, 4)):
            order = rng.choice(["little_endian", "big_endian"])
            is_float = rng.random() < 0.15
            length = 32 if is_float else rng.choice([1, 5, 8, 12, 16, 24])
            start = rng.randrange(64)
            if order == "little_endian":
                taken = [start + bit for bit in range(length)]
            else:
                taken, at = [], start
                for _ in range(length):
                    taken.append(at)
                    at = at + 15 if at % 8 == 0 else at - 1
            if not set(taken) <= set(range(64)) - used:
                continue
            used |= set(taken)
            scale, offset = rng.choice([(1, 0), (0.01, 0), (0.5, -40), (0.1, 3.7), (-2, 1)])
            conv = BaseConversion.factory(scale=scale, offset=offset, is_float=is_float)
            mux = (
                {"multiplexer_ids": [rng.randrange(3)], "multiplexer_signal": f"mode_{number}"}
                if multiplexed and rng.random() < 0.6
                else {}
            )
            signals.append(
                CanSignal(
                    f"signal_{number}_{index}",
                    start,
                    length,
                    byte_order=order,
                    is_signed=is_float or rng.random() < 0.5,
                    conversion=conv,
                    **mux,
                )
            )
        if signals:
            messages.append(Message(id_, f"message_{number}", 8, signals, is_extended_frame=is_extended, strict=True))
    database = Database(messages=messages, version="")
    dbc = path.with_suffix(".dbc")
    dbc.write_text(database.as_dbc_string(), encoding="cp1252")
    database = cantools.database.load_file(dbc)
    values = {}
    time = 0.0
    for _ in range(rng.choice([1, 20, 500])):
        time += rng.uniform(0.001, 0.03)
        message = rng.choice(database.messages)
        data = bytearray(rng.randbytes(8))
        modes = [mode for signal in message.signals for mode in signal.multiplexer_ids or []]
        if modes:
            data[0] = data[0] & 0xF0 | rng.choice(modes)
        frames.append((time, message.frame_id | (message.is_extended_frame << 31), bytes(data)))
        decoded = message.decode(bytes(data), decode_choices=False, allow_truncated=True)
        for name, value in decoded.items():
            found = values.setdefault(name, {"times": [], "values": []})
            found["times"] += bits([time])
            found["values"] += bits([value])
    types = [
        ("CAN_DataFrame.BusChannel", "<u1"),
        ("CAN_DataFrame.ID", "<u4"),
        ("CAN_DataFrame.IDE", "<u1"),
        ("CAN_DataFrame.DLC", "<u1"),
        ("CAN_DataFrame.DataLength", "<u1"),
        ("CAN_DataFrame.DataBytes", "(8,)u1"),
    ]
    records = np.zeros(len(frames), dtype=types)
    records["CAN_DataFrame.BusChannel"] = 1
    records["CAN_DataFrame.ID"] = [frame[1] & 0x1FFFFFFF for frame in frames]
    records["CAN_DataFrame.IDE"] = [frame[1] >> 31 for frame in frames]
    records["CAN_DataFrame.DLC"] = records["CAN_DataFrame.DataLength"] = 8
    records["CAN_DataFrame.DataBytes"] = [list(frame[2]) for frame in frames]
    mdf = MDF(version="4.11")
    source = Source("CAN 1", "CAN 1", "", source_type=v4.SOURCE_BUS, bus_type=v4.BUS_TYPE_CAN)
    signal = Signal(records, np.array([frame[0] for frame in frames]), name="CAN_DataFrame", source=source)
    mdf.append(signal)
    mdf.save(path, compression=rng.choice([0, 2]), overwrite=True)
    mdf.close()
    return values


def main(folder, count):
    folder = Path(folder)
    for number in range(count):
        rng = random.Random(number)
        path = folder / f"{number:04}.mf4"
        values = (write_frames if number % 4 == 3 else write_channels)(path, rng)
        path.with_suffix(".json").write_text(json.dumps(values))


main(sys.argv[1], int(sys.argv[2]))
