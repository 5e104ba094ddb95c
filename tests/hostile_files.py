#!/usr/bin/env python3
"""Attacks all readers of crumple with hostile files: damaged bytes, hostile structures, and extreme sizes.

Each file runs one subcommand as a process. A failure is: an exit code other than 0 to 3, a signal, a text of a panic,
more than one error, an error longer than 4 KB, more than 10 s, or more than 500 MB of memory. A file that takes longer
runs again and may then take 60 s, but only 10 s of processor time, because the machine may have been busy. Failing
files are stored with their command, standard error and reason.

One seed determines all files, except addresses of temporary folders. Needs Python 3.11 on Linux and a release build
with all features:

    cargo build --release --locked --all-features
    CRUMPLE=target/release/crumple tests/hostile_files.py --count 10000 --out failures

`--only 1234` runs a single file again, and `--target onnx` only those of one reader.
"""

import argparse
import base64
import bz2
import collections
import concurrent.futures
import gzip
import io
import json
import lzma
import os
import pathlib
import random
import re
import resource
import shutil
import struct
import subprocess
import sys
import tempfile
import threading
import time
import zipfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
MAX_BYTES = 16_000_000
MAX_SECONDS = 10.0
MAX_RSS_BYTES = 500_000_000
MAX_ERROR_BYTES = 4096
# Address space, so that a wrong size cannot exhaust the machine. Threads reserve far more than they use.
MAX_ADDRESS_BYTES = 8_000_000_000

# As a count, each number is at most 10 or refused: the attack measures reading, not the work that a file requests.
EDGE_NUMBERS = [
    "nan", "inf", "-inf", "-0.0", "0", "1", "-1", "0.5", "1e308", "-1e308", "1e309", "1e-320", "5e-324",
    "9223372036854775807", "-9223372036854775808", "18446744073709551616", "2147483648", "4294967295", "1e5", "1e9",
    "1" * 400, "0." + "0" * 400 + "1", "0x7fffffffffffffff", "1_0", "+5", "١٢", "1,5", "",
]  # fmt: skip
HOSTILE_TEXTS = [
    "", " ", "\0", "/", "..", "/dev/zero", "/dev/null", "/dev/stdin", "/proc/self/mem", "/etc/passwd", "fifo", "loop",
    "folder", "input", "\u202e\u200b", "\x1b[2J", "a\nb", "é" * 1000, "'\"`$(x)\\", "%s%n", "${a}", "$a", "x" * 100_000,
    "NaN", "true", "-1", "\ufeff", "\U0001f600", "[]", "{}", "None", "paper-1", "idm",
]  # fmt: skip


class Case:
    """Files of one run, by name; the first one is the hostile file. Names of folders, FIFOs and links are reserved."""

    def __init__(self, files, arguments):
        self.files = files
        self.arguments = arguments


# Damaged bytes.


def mutate_bytes(rng, data):
    """Changes, inserts, removes, repeats or exchanges some bytes, up to eight times."""
    data = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 4, 8])):
        at = rng.randrange(len(data) + 1)
        length = min(rng.choice([1, 1, 2, 4, 8, 64, 1024]), len(data) - at)
        action = rng.randrange(7)
        if action == 0 and length:
            data[at] ^= 1 << rng.randrange(8)
        elif action == 1:
            data[at : at + length] = rng.randbytes(length)
        elif action == 2:
            del data[at : at + length]
        elif action == 3:
            data[at:at] = data[at : at + length] * rng.choice([1, 2, 10, 100])
        elif action == 4:
            data[at : at + length] = rng.choice([b"\0", b"\xff", b"\x7f", b"\x80", b'"', b"\n", b","]) * length
        elif action == 5:
            number = rng.choice([0, 1, -1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, -(2**63), 1 << 40, 255])
            width = rng.choice([1, 2, 4, 8])
            data[at : at + width] = (number & ((1 << 8 * width) - 1)).to_bytes(width, rng.choice(["little", "big"]))
        else:
            other = rng.randrange(len(data) + 1)
            data[at : at + length] = data[other : other + length]
    return bytes(data[:MAX_BYTES])


NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")


def mutate_numbers(rng, data):
    """Replaces some numbers of a text by numbers at the edges."""
    places = list(NUMBER.finditer(data))
    if not places:
        return mutate_bytes(rng, data)
    chosen = rng.sample(places, min(len(places), rng.choice([1, 1, 1, 2, 5])))
    for place in sorted(chosen, key=lambda found: -found.start()):
        data = data[: place.start()] + rng.choice(EDGE_NUMBERS).encode() + data[place.end() :]
    return data


QUOTED = re.compile(rb'"[^"\n]*"')


def mutate_texts(rng, data):
    """Replaces some quoted texts by hostile ones, or by texts of other places."""
    places = list(QUOTED.finditer(data))
    if not places:
        return mutate_bytes(rng, data)
    for place in sorted(
        rng.sample(places, min(len(places), rng.choice([1, 1, 2, 4]))), key=lambda found: -found.start()
    ):
        text = rng.choice(HOSTILE_TEXTS).encode() if rng.random() < 0.7 else rng.choice(places).group()[1:-1]
        data = data[: place.start() + 1] + text + data[place.end() - 1 :]
    return data


def mutate_lines(rng, data):
    """Removes, repeats, exchanges or joins lines."""
    lines = data.split(b"\n")
    for _ in range(rng.choice([1, 2, 4])):
        at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        action = rng.randrange(5)
        if action == 0 and len(lines) > 1:
            del lines[at]
        elif action == 1:
            lines[other:other] = [lines[at]] * rng.choice([1, 2, 1000])
        elif action == 2:
            lines[at], lines[other] = lines[other], lines[at]
        elif action == 3:
            lines[at] += lines[other]
        else:
            lines[at] = lines[at][: rng.randrange(len(lines[at]) + 1)]
    return b"\n".join(lines)[:MAX_BYTES]


def resize(rng, data):
    """Returns an empty, tiny, truncated or huge file."""
    action = rng.randrange(12)
    if action == 0:
        return b""
    if action == 1:
        return rng.randbytes(1)
    if action == 2:
        return rng.choice([b"\0", b"\xff", b" ", b"\n", b"[", b"{", b"<", b'"', b"(", b"0"]) * rng.choice(
            [100, 10**6, MAX_BYTES]
        )
    if action == 3:
        return (data * (MAX_BYTES // max(len(data), 1) + 1))[: rng.choice([200_000, MAX_BYTES])]
    if action == 4:
        lines = data.split(b"\n")
        middle = lines[len(lines) // 2 : len(lines) // 2 + 3] * (MAX_BYTES // max(len(data) // len(lines) * 3, 1))
        return b"\n".join(lines[: len(lines) // 2] + middle)[:MAX_BYTES]
    if action == 5:
        at = rng.randrange(len(data) + 1)
        return data[:at] + rng.choice([b"0", b"a", b" ", b"-", b"\xc3"]) * rng.choice([10**5, 4 * 10**6]) + data[at:]
    if action == 6:
        ends = [found.end() for found in re.finditer(rb"[\n,;>}\]\0]", data)] or [0]
        return data[: rng.choice(ends)]
    if action == 7:
        return rng.choice([b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff"]) + data
    if action == 8:
        return data.decode("utf-8", "replace").encode(rng.choice(["utf-16", "utf-32", "utf-7"]), "replace")
    return data[: rng.randrange(len(data) + 1)]


# Structures of text formats.


def nested(rng, opening, closing, inside=b"1"):
    depth = rng.choice([50, 129, 1000, 10_000, 100_000, 1_000_000])
    return (opening * depth + inside + (closing * depth if rng.random() < 0.7 else b""))[:MAX_BYTES]


def toml_structures(rng, data):
    count = rng.choice([1000, 20_000, 200_000])
    name = rng.choice([b"vehicles", b"parameters", b"inputs", b"gates", b"version", b"layout", b"a"])
    action = rng.randrange(10)
    if action == 0:
        return data + b"\n" + name + b" = " + nested(rng, b"[", b"]")
    if action == 1:
        return data + b"\n" + name + b" = " + nested(rng, b"{a=", b"}")
    if action == 2:
        return data + b"\n" + b".".join([b"a"] * count) + b" = 1\n"
    if action == 3:
        return data + b"\n" + b"".join(b"k%d = 1\n" % index for index in range(count))
    if action == 4:
        return data + b"\n" + b"".join(b"[[" + name + b"]]\n" for _ in range(count))
    if action == 5:
        return b'"' + b"k" * rng.choice([1000, 10**6]) + b'" = 1\n' + data
    if action == 6:
        return data + b"\n" + name + b" = [" + rng.choice([b"1.0,", b"{},", b'"",', b"[],"]) * count + b"]\n"
    if action == 7:
        return data + b"\n[" + b".".join([b"a"] * rng.choice([100, 10_000])) + b"]\n"
    if action == 8:
        return b"version = 1\n" + data
    return mutate_texts(rng, mutate_numbers(rng, data))


def json_structures(rng, data):
    count = rng.choice([1000, 100_000, 1_000_000])
    action = rng.randrange(8)
    if action == 0:
        return nested(rng, b"[", b"]")
    if action == 1:
        return nested(rng, b'{"a":', b"}")
    if action == 2:
        places = [found.end() for found in re.finditer(rb"[:\[,]", data)] or [0]
        at = rng.choice(places)
        return data[:at] + nested(rng, b"[", b"]") + b"," + data[at:]
    if action == 3:
        return data.replace(b"[", b"[" + rng.choice([b"0,", b"null,", b'"",', b"{},"]) * count, 1)[:MAX_BYTES]
    if action == 4:
        return data.replace(b"{", b'{"' + b"k" * count + b'":1,', 1)[:MAX_BYTES]
    if action == 5:
        return data.replace(b"{", b"{" + b"".join(b'"k%d":1,' % index for index in range(count // 10)), 1)[:MAX_BYTES]
    if action == 6:
        return data.replace(b'"', b'"\\ud800', 1)
    return mutate_texts(rng, mutate_numbers(rng, data))


ELEMENT = re.compile(rb"<(\w+)[^<>]*/>")


def xml_structures(rng, data):
    count = rng.choice([1000, 20_000, 200_000])
    action = rng.randrange(11)
    ends = [found.end() for found in re.finditer(rb">", data)] or [0]
    at = rng.choice(ends)
    if action == 0:
        return data[:at] + nested(rng, b"<a>", b"</a>") + data[at:]
    if action == 1:
        bomb = b'<!DOCTYPE a [<!ENTITY b0 "bbbbbbbbbb">' + b"".join(
            b'<!ENTITY b%d "%s">' % (level, b"&b%d;" % (level - 1) * 10) for level in range(1, 12)
        )
        return bomb + b"]>" + QUOTED.sub(b'"&b11;"', data, 3)
    if action == 2:
        return data.replace(b" ", b" " + b"".join(b'a%d="1" ' % index for index in range(count)), 1)[:MAX_BYTES]
    if action == 3:
        elements = list(ELEMENT.finditer(data))
        if elements:
            found = rng.choice(elements)
            copies = min(count, MAX_BYTES // len(found.group()))
            return (data[: found.start()] + found.group() * copies + data[found.end() :])[:MAX_BYTES]
    if action == 4:
        return data[:at] + b"<!--" + b"-" * count + b"-->" + data[at:]
    if action == 5:
        return data[:at] + b"<![CDATA[" + b"x" * count + b"]]>" + data[at:]
    if action == 6:
        return data[:at] + b"<?x " + b"y" * count + b"?>" + data[at:]
    if action == 7:
        parameters = b"".join(
            b'<ParameterDeclaration name="p%d" parameterType="double" value="$p%d"/>' % (index, (index + 1) % 50)
            for index in range(50)
        )
        return data.replace(
            b"<ParameterDeclarations/>", b"<ParameterDeclarations>" + parameters + b"</ParameterDeclarations>"
        )
    if action == 8:
        expression = rng.choice(
            [b"(" * 50_000, b"1+" * 100_000, b"-" * 100_000, b"$a", b"pow(10,308)*10", b"1/0", b"sqrt(-1)"]
        )
        return (
            NUMBER.sub(b"${" + expression + b"}", data, 1)
            if rng.random() < 0.5
            else QUOTED.sub(b'"${' + expression + b'}"', data, 5)
        )
    return mutate_texts(rng, mutate_numbers(rng, data))


def csv_structures(rng, data):
    lines = data.split(b"\n")
    count = rng.choice([1000, 30_000, 300_000])
    row = rng.randrange(len(lines))
    fields = lines[row].split(b",")
    action = rng.randrange(10)
    if action == 0:
        fields[rng.randrange(len(fields))] = b'"' + b'""' * count + b'"'
    elif action == 1:
        fields[rng.randrange(len(fields))] = b'"' + b"x" * count
    elif action == 2:
        fields += [b"1"] * count
    elif action == 3:
        fields = [rng.choice(EDGE_NUMBERS).encode() for _ in fields]
    elif action == 4:
        fields[rng.randrange(len(fields))] = rng.choice(HOSTILE_TEXTS).encode()
    elif action == 5:
        lines = lines[:1] + lines[1:] * (min(MAX_BYTES // max(len(data), 1), 300))
        row, fields = 0, lines[0].split(b",")
    elif action == 6:
        return data.replace(b",", rng.choice([b";", b"\t", b",,", b" ", b"\0", b"|"]))
    elif action == 7:
        return data.replace(b"\n", rng.choice([b"\r", b"\r\n", b"\n\n", b"\n#\n", b'\n"']))
    elif action == 8:
        column = rng.randrange(len(fields))
        table = [line.split(b",") for line in lines]
        for cells in table[1:]:
            if column < len(cells):
                cells[column] = (
                    rng.choice(EDGE_NUMBERS).encode() if rng.random() < 0.3 else b"%d" % rng.randrange(10**12)
                )
        return b"\n".join(b",".join(cells) for cells in table)
    else:
        return mutate_numbers(rng, data)
    lines[row] = b",".join(fields)
    return b"\n".join(lines)[:MAX_BYTES]


# Structures of binary formats.


def varint(number):
    out = bytearray()
    number &= (1 << 64) - 1
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes(out) + bytes([number])


def message(field, payload, length=None):
    return varint(field << 3 | 2) + varint(len(payload) if length is None else length) + payload


def number(field, value):
    return varint(field << 3) + varint(value)


def onnx_tensor(rng, name):
    dims = rng.choice([[1], [3, 8], [0], [-1, 8], [2**31, 2**31], [1] * 1000, [2**62], [8, 8], []])
    parts = [number(1, dim) for dim in dims] + [number(2, rng.choice([1, 11, 7, 99, 10])), message(8, name)]
    count = rng.choice([0, 1, 24, 64, 1_000_000])
    value = struct.pack("<f", rng.choice([0.0, float("nan"), float("inf"), 1e38, -1.0, 1e-45]))
    form = rng.randrange(4)
    if form == 0:
        parts.append(message(9, value * count))
    elif form == 1:
        parts.append(message(4, value * count))
    elif form == 2:
        parts += [number(14, 1), message(13, message(1, b"location") + message(2, rng.choice(HOSTILE_TEXTS).encode()))]
    return b"".join(parts)


def onnx_structures(rng, data):
    """Writes graphs: deep, wide, with false sizes, external data and links in circles."""
    action = rng.randrange(6)
    names = [b"obs", b"a", b"b", b"w", b"", b"x" * rng.choice([10, 100_000])]
    if action == 0:
        graph = b""
        for _ in range(rng.choice([10, 101, 2000, 20_000])):
            graph = message(
                1,
                message(1, b"a")
                + message(2, b"b")
                + message(4, b"If")
                + message(5, message(1, b"g") + message(6, graph)),
            )
            if len(graph) > MAX_BYTES:
                break
        return message(7, graph)[:MAX_BYTES]
    if action == 1:
        return data + message(7, b"", rng.choice([2**31, 2**63, 2**64 - 1])) + rng.randbytes(10)
    if action == 2:
        return data + number(rng.randrange(1, 30), 2**64 - 1) + message(rng.randrange(1, 30), data)
    operators = [
        b"Gemm",
        b"MatMul",
        b"Add",
        b"Relu",
        b"Reshape",
        b"Conv",
        b"Clip",
        b"Cast",
        b"Flatten",
        b"Constant",
        b"Tanh",
    ]
    parts = []
    for _ in range(rng.choice([1, 3, 10, 300, 50_000])):
        inputs = b"".join(message(1, rng.choice(names[:5])) for _ in range(rng.randrange(4)))
        attribute = message(1, rng.choice([b"value", b"axis", b"to", b"alpha", b"transB"])) + number(
            3, rng.choice([0, 1, -1, 2**62])
        )
        parts.append(
            message(
                1,
                inputs + message(2, rng.choice(names[:5])) + message(4, rng.choice(operators)) + message(5, attribute),
            )
        )
    parts += [message(5, onnx_tensor(rng, rng.choice(names[:5]))) for _ in range(rng.choice([0, 1, 3, 1000]))]
    shape = b"".join(
        message(1, number(1, rng.choice([1, 8, 0, -1, 2**40]))) for _ in range(rng.choice([0, 1, 2, 4, 1000]))
    )
    value = message(1, rng.choice(names)) + message(2, message(1, number(1, 1) + message(2, shape)))
    parts += [message(11, value), message(12, value)]
    model = (
        number(1, 8)
        + message(7, b"".join(parts))
        + message(8, message(1, b"") + number(2, rng.choice([6, 13, 0, 2**63])))
    )
    return model[:MAX_BYTES]


def zip_of(entries, compression=zipfile.ZIP_DEFLATED):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as archive:
        for name, data in entries:
            archive.writestr(name, data)
    return out.getvalue()


def zip_structures(rng, data, replace=None):
    """Rewrites an archive: bombs, many entries, hostile names, false sizes, methods that are rare."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = [(info.filename, archive.read(info)) for info in archive.infolist()]
    except zipfile.BadZipFile:
        entries = [("data", data)]
    at = rng.randrange(len(entries))
    name, content = entries[at]
    action = rng.randrange(9)
    if action == 0:
        entries[at] = (name, content + b"\0" * rng.choice([10**6, 70_000_000]))
    elif action == 1:
        entries += [(f"{index}", b"") for index in range(rng.choice([100, 5000]))]
    elif action == 2:
        entries.append((rng.choice(["../x", "/etc/x", "a" * 60_000, "C:\\x", "a/../../b", "é", name]), content))
    elif action == 3:
        return zip_of(entries, rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]))
    elif action == 4:
        made = bytearray(zip_of(entries))
        for found in re.finditer(rb"PK\x01\x02", bytes(made)):
            offset = found.start() + rng.choice([20, 24, 28, 30, 32, 42])
            made[offset : offset + 4] = rng.choice([0, 2**32 - 1, 2**31, 10**9, 1]).to_bytes(4, "little")
        return bytes(made)
    elif action == 5:
        entries[at] = (name, zip_of(entries))
    elif action == 6:
        made = zip_of(entries)
        return made[:-22] + b"PK\x05\x06" + rng.randbytes(18)
    elif replace is not None:
        entries[at] = (name, replace(rng, name, content))
    else:
        entries[at] = (name, mutate_bytes(rng, content))
    return zip_of(entries)[:MAX_BYTES]


def pickle_structures(rng, _name=None, data=b""):
    """Writes pickles: doubling tuples, huge memo indices and lengths, deep lists, calls of functions."""
    return rng.choice(
        [
            b"\x80\x04]q\x00" + b"h\x00h\x00\x86q\x00" * rng.choice([30, 5000]) + b".",
            b"\x80\x04" + b"](" * rng.choice([1000, 1_000_000]) + b".",
            b"\x80\x04" + b"(" * 1_000_000 + b"l.",
            b"\x80\x04N\x94" + b"r" + b"\xff" * 4 + b".",
            b"\x80\x04\x8d" + (2**63).to_bytes(8, "little") + b"a.",
            b"\x80\x04B" + b"\xff\xff\xff\xff" + b"a.",
            b"\x80\x04\x95" + b"\xff" * 8 + b"N.",
            b"cos\nsystem\n(S'touch pwned'\ntR.",
            b"\x80\x02cnumpy\nndarray\n(K\x00\x85tR.",
            b"I" + b"9" * 1_000_000 + b"\n.",
            b"\x8b" + (1_000_000).to_bytes(4, "little") + b"\xff" * 1_000_000 + b".",
            b"2" * 1000 + b".",
            b"\x80\x04}" + b"(" + b"K\x01K\x02" * 500_000 + b"u.",
            mutate_bytes(rng, data),
        ]
    )


def sb3_entry(rng, name, content):
    """Damages an entry of a model of Stable-Baselines3 within its own format."""
    if name.endswith(".pth"):
        return zip_structures(rng, content, pickle_structures)
    if name == "data" and rng.random() < 0.6:
        try:
            fields = json.loads(content)
        except ValueError:
            return mutate_bytes(rng, content)
        chosen = rng.choice([key for key, value in fields.items() if isinstance(value, dict)] or [""])
        if chosen and ":serialized:" in fields[chosen]:
            original = base64.b64decode(fields[chosen][":serialized:"])
            fields[chosen][":serialized:"] = base64.b64encode(pickle_structures(rng, data=original)).decode()
        return json.dumps(fields).encode()
    return json_structures(rng, content)


def safetensors_structures(rng, data):
    if len(data) < 8:
        return data
    length = int.from_bytes(data[:8], "little")
    header, body = data[8 : 8 + length], data[8 + length :]
    action = rng.randrange(6)
    if action == 0:
        return rng.choice([0, 1, 2**63, 2**64 - 1, len(data), 100_000_001, 2**31]).to_bytes(8, "little") + data[8:]
    if action == 1:
        header = json_structures(rng, header)
    elif action == 2:
        header = mutate_numbers(rng, header)
    elif action == 3:
        header = mutate_texts(rng, header)
    elif action == 4:
        value = struct.pack("<f", rng.choice([float("nan"), float("inf"), 3e38, -0.0, 1e-45]))
        body = value * (len(body) // 4)
    else:
        body = body * rng.choice([0, 2, 100])
    return (len(header).to_bytes(8, "little") + header + body)[:MAX_BYTES]


def thrift_string(data, length=None):
    return varint(len(data) if length is None else length) + data


def parquet_structures(rng, data):
    """Writes footers with deep or wide schemas and false counts, or exchanges the footer of a file."""
    schema = []
    count = rng.choice([1, 3, 2000, 200_000])
    for index in range(count):
        children = rng.choice([1, 0, 2**31 - 1, -1, 10**9]) if rng.random() < 0.1 else 1
        zigzag = varint(children * 2 if children >= 0 else -children * 2 - 1)
        name = thrift_string(rng.choice([b"a", b"", b"x" * 1000]) if index < 100 else b"a")
        schema.append(b"\x48" + name + b"\x15" + zigzag + b"\x00")
    size = rng.choice([count, 2**31 - 1, 0, count + 1])
    footer = b"\x15\x02\x19" + (bytes([size << 4 | 12]) if size < 15 else b"\xfc" + varint(size)) + b"".join(schema)
    rows = rng.choice([0, 1, 2**62, -1])
    footer += (
        b"\x16"
        + varint(rows * 2 if rows >= 0 else -rows * 2 - 1)
        + b"\x19"
        + rng.choice([b"\x0c", b"\xfc\xff\xff\xff\x7f", b"\x1c"])
        + b"\x00"
    )
    if rng.random() < 0.4 and len(data) > 12:
        end = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
        if 4 < end < len(data):
            footer = mutate_bytes(rng, data[end:-8])
            return data[:end] + footer + len(footer).to_bytes(4, "little") + b"PAR1"
    length = rng.choice([len(footer), len(footer), len(footer), 0, 2**32 - 1, 2**31])
    return (b"PAR1" + footer + length.to_bytes(4, "little") + b"PAR1")[-MAX_BYTES:]


def mdf_structures(rng, data):
    """Exchanges links of blocks, so that they form circles or share blocks, and lengths of blocks."""
    data = bytearray(data)
    blocks = [found.start() for found in re.finditer(rb"##[A-Z]{2}", bytes(data)) if found.start() % 8 == 0]
    if not blocks:
        return mutate_bytes(rng, bytes(data))
    for _ in range(rng.choice([1, 2, 5, 20])):
        block = rng.choice(blocks)
        links = min(int.from_bytes(data[block + 16 : block + 24], "little"), 100)
        action = rng.randrange(4)
        if action == 0 and links:
            at = block + 24 + 8 * rng.randrange(links)
            data[at : at + 8] = rng.choice(blocks + [0, 2**63, len(data)]).to_bytes(8, "little")
        elif action == 1:
            length = rng.choice([0, 8, 24, 2**40, 2**64 - 1, len(data)])
            data[block + 8 : block + 16] = length.to_bytes(8, "little")
        elif action == 2:
            data[block + 16 : block + 24] = rng.choice([0, 1, 100_000, 2**62]).to_bytes(8, "little")
        else:
            at = block + 24 + 8 * links + rng.randrange(64)
            width = rng.choice([1, 2, 4, 8])
            value = rng.choice([0, 1, 255, 2**31, 2**32 - 1, 2**63, 2**64 - 1]) & ((1 << 8 * width) - 1)
            data[at : at + width] = value.to_bytes(width, "little")
    return bytes(data[:MAX_BYTES])


def dbc_structures(rng, data):
    count = rng.choice([100, 5000, 100_000])
    signals = [line for line in data.split(b"\n") if line.lstrip().startswith(b"SG_")] or [
        b' SG_ a m0M : 0|8@1+ (1,0) [0|0] "" X'
    ]
    action = rng.randrange(6)
    if action == 0:
        line = rng.choice(signals)
        return data.replace(line, b"\n".join(line.replace(b"SG_ ", b"SG_ s%d_" % index) for index in range(count)), 1)[
            :MAX_BYTES
        ]
    if action == 1:
        return data + b"\n".join(
            b'BO_ %d M%d: 8 X\n SG_ a m%dM : 0|8@1+ (1,0) [0|0] "" X' % (index, index, index)
            for index in range(count // 10)
        )
    if action == 2:
        return data.replace(b" : ", b" m%dM : " % rng.choice([0, 1, 2**40]))
    if action == 3:
        return data + b"\nSG_MUL_VAL_ 1 a b 0-18446744073709551615;\nSG_MUL_VAL_ 1 b a 0-0;\n" * rng.choice([1, count])
    if action == 4:
        return data.replace(b"SG_ ", b"SG_ " + b"x" * count, 1)
    return mutate_numbers(rng, data)


def compressed(rng, data):
    """Compresses a file, or a bomb of 200 MB."""
    if rng.random() < 0.5:
        return gzip.compress(b"\0" * 200_000_000, 1)
    return rng.choice([gzip.compress, bz2.compress, lzma.compress])(data)[:MAX_BYTES]


STRUCTURES = {
    "toml": [toml_structures, mutate_numbers, mutate_texts, mutate_lines],
    "json": [json_structures, mutate_numbers, mutate_texts, mutate_lines],
    "xml": [xml_structures, mutate_numbers, mutate_texts, mutate_lines],
    "csv": [csv_structures, csv_structures, mutate_numbers, mutate_lines],
    "onnx": [onnx_structures],
    "sb3": [lambda rng, data: zip_structures(rng, data, sb3_entry)],
    "fmu": [lambda rng, data: zip_structures(rng, data, lambda rng, _, content: xml_structures(rng, content))],
    "pickle": [lambda rng, data: pickle_structures(rng, data=data)],
    "safetensors": [safetensors_structures],
    "parquet": [parquet_structures],
    "mdf": [mdf_structures],
    "dbc": [dbc_structures, mutate_numbers, mutate_lines],
    "formula": [mutate_numbers, lambda rng, data: formula_structures(rng, data)],
}


def formula_structures(rng, data):
    depth = rng.choice([10, 65, 1000, 30_000])
    return rng.choice(
        [
            b"(" * depth + data + b")" * depth,
            b"not " * depth + data,
            b" and ".join([data] * min(depth, 120_000 // (len(data) + 5))),
            b"always[0,1] " * min(depth, 9000) + data,
            b"always[0,%s] v1.gap_m > %s" % (rng.choice(EDGE_NUMBERS).encode(), rng.choice(EDGE_NUMBERS).encode()),
            data.replace(b"v1", b"v" + rng.choice(EDGE_NUMBERS).encode()),
        ]
    )[:120_000]


# Readers.


class Target:
    """A reader: its seeds, the format of its structures, and the command that reads a file."""

    def __init__(self, name, form, extension, seeds, arguments, beside=None):
        self.name = name
        self.form = form
        self.extension = extension
        self.seeds = seeds
        self.arguments = arguments
        self.beside = beside or {}

    def case(self, rng):
        seed = rng.choice(self.seeds)
        kind = rng.choices(["bytes", "structures", "sizes", "places"], [48, 38, 12, 2])[0]
        name = "input" + self.extension
        arguments = rng.choice(self.arguments)
        if kind == "places":
            # Files that are no regular files, or that do not exist.
            return kind, Case(
                dict(self.beside),
                [
                    rng.choice(["fifo", "loop", "folder", "absent", "/dev/zero"]) if part == "{file}" else part
                    for part in arguments
                ],
            )
        if kind == "bytes":
            data = mutate_bytes(rng, seed)
        elif kind == "sizes":
            data = compressed(rng, seed) if rng.random() < 0.05 else resize(rng, seed)
        else:
            data = rng.choice(STRUCTURES[self.form])(rng, seed)
        return kind, Case({name: data[:MAX_BYTES], **self.beside}, arguments)


def read_seeds(*patterns, limit=300_000):
    paths = [path for pattern in patterns for path in sorted(ROOT.glob(pattern)) if path.is_file()]
    seeds = [path.read_bytes() for path in paths if path.stat().st_size <= limit]
    if not seeds:
        sys.exit(f"error: no seeds {patterns}")
    return seeds


SMALL_ASSESSMENT = b"""version = 1
controllers = ["idm"]
paper = false
distributions = ["high-risk"]
draws = 2
everyday_draws = 0
rates = { runs = 0, confidence = 0.99 }
search = { spaces = [], budget = 1 }
scenarios = ["scenario.toml"]
certificates = []
[[gates]]
require = "no-collision-in-space"
controller = "idm"
space = "high-risk"
"""
DISTRIBUTION = b"""<?xml version="1.0"?>
<OpenSCENARIO>
  <FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" description="speeds" author="crumple"/>
  <ParameterValueDistribution>
    <ScenarioFile filepath="s.xosc"/>
    <Deterministic>
      <DeterministicSingleParameterDistribution parameterName="v">
        <DistributionRange stepWidth="5"><Range lowerLimit="10" upperLimit="30"/></DistributionRange>
      </DeterministicSingleParameterDistribution>
    </Deterministic>
  </ParameterValueDistribution>
</OpenSCENARIO>
"""
FORMULAS = [
    b"always v1.gap_m > 0",
    b"always (v1.gap_m > 2 and v2.gap_m > 2)",
    b"eventually[0,5] v1.speed_mps < 5",
    b"no contact",
]


def exported(program, work):
    """Exports built-in scenarios as seeds of OpenSCENARIO."""
    for what in ["actions", "trajectories"]:
        command = [
            program,
            "-q",
            "export",
            "paper-1",
            "paper-2",
            "--to",
            "openscenario",
            "--as",
            what,
            "--out",
            work / what,
        ]
        if what == "trajectories":
            command += ["--controller", "idm"]
        subprocess.run(command, check=True, capture_output=True)
    return [path.read_bytes() for path in sorted(work.glob("*/*.xosc"))], (
        work / "actions" / "paper-1.xodr"
    ).read_bytes()


def targets(program, work):
    storyboards, road = exported(program, work)
    declared = b'<ParameterDeclaration name="v" parameterType="double" value="25"/>'
    declared = b"<ParameterDeclarations>" + declared + b"</ParameterDeclarations>"
    with_parameter = (
        storyboards[0].replace(b"<ParameterDeclarations/>", declared).replace(b'value="25.0"', b'value="$v"', 1)
    )
    roads = {"paper-1.xodr": road, "paper-2.xodr": road}
    manifest, campaign = run_folder(program, work)
    cases = "corpora/recordings/cases/"
    scenario = read_seeds("corpora/scenarios/idm-hits*.toml")[0]
    mdf_map = read_seeds("corpora/recordings/mdf/map.toml")[0]
    dbc_map = mdf_map.replace(b"version = 1", b'version = 1\ndbc = "input.dbc"').replace(b"gap_m", b"signal_0_0")
    dbc_map = dbc_map.replace(b"ego_mps", b"signal_1_0").replace(b"lead_mps", b"signal_2_0")
    dbc_log = read_seeds("corpora/recordings/mdf/0019.mf4")[0]
    controllers = "corpora/controllers/"
    run_idm = ["simulate", "paper-1", "--controller", "{file}", "--estimator", "truth"]
    fmu = zip_of(
        [
            ("modelDescription.xml", read_seeds("corpora/fuzz/fmu_file/fmi-2")[0]),
            ("binaries/linux64/follower.so", b"\x7fELF"),
        ]
    )
    fmu_3 = zip_of(
        [("modelDescription.xml", read_seeds("corpora/fuzz/fmu_file/fmi-3")[0]), ("binaries/linux64/odd.so", b"")]
    )
    presets = [
        subprocess.run([program, "show", name, "--kind", "preset"], capture_output=True).stdout
        for name in ["fast", "road"]
    ]
    import_text = [
        ["import", "{file}", "--out", "out"],
        ["replay", "{file}", "--controller", "idm"],
        ["import", "{file}", "--guess"],
    ]
    maps = {name: read_seeds(cases + name + ".toml")[0] for name in ["highd", "ngsim", "sumo"]}
    with_maps = [["import", "{file}", "--map", name + ".toml", "--out", "out"] for name in maps]
    return [
        Target(
            "recording",
            "csv",
            ".csv",
            read_seeds("corpora/recordings/*.csv", cases + "*.csv"),
            import_text + with_maps,
            {name + ".toml": text for name, text in maps.items()},
        ),
        Target(
            "map",
            "toml",
            ".toml",
            read_seeds(cases + "*.toml", "crates/exchange/src/recording/built_in/*.toml"),
            [["import", "log.csv", "--map", "{file}", "--out", "out"]],
            {"log.csv": read_seeds(cases + "h_queue.csv")[0]},
        ),
        Target(
            "parquet",
            "parquet",
            ".parquet",
            read_seeds("corpora/versions/*/campaign/evaluations/*.parquet", "corpora/fuzz/binary_recording/parquet*"),
            [
                ["import", "{file}", "--out", "out"],
                ["import", "{file}", "--guess"],
                ["import", "{file}", "--map", "map.toml", "--out", "out"],
            ],
            {"map.toml": mdf_map},
        ),
        Target(
            "mdf",
            "mdf",
            ".mf4",
            read_seeds(
                "corpora/recordings/mdf/*.mf4",
                "corpora/fuzz/binary_recording/[dft]*",
                "corpora/fuzz/binary_recording/plain",
            ),
            [["import", "{file}", "--map", "map.toml", "--out", "out"], ["import", "{file}", "--guess"]],
            {"map.toml": mdf_map},
        ),
        Target(
            "dbc",
            "dbc",
            ".dbc",
            read_seeds("corpora/recordings/mdf/*.dbc"),
            [["import", "log.mf4", "--map", "map.toml", "--out", "out"]],
            {"map.toml": dbc_map, "log.mf4": dbc_log},
        ),
        Target(
            "openscenario",
            "xml",
            ".xosc",
            storyboards,
            [["import", "{file}", "--out", "out"], ["import", "{file}", "--ego", "vehicle_1", "--out", "out"]],
            roads,
        ),
        Target(
            "opendrive",
            "xml",
            ".xodr",
            [road],
            [["import", "s.xosc", "--out", "out"]],
            {"s.xosc": storyboards[0].replace(b"paper-1.xodr", b"input.xodr")},
        ),
        Target(
            "distribution",
            "xml",
            ".xosc",
            [DISTRIBUTION],
            [["import", "s.xosc", "--distribution", "{file}", "--out", "out"]],
            {"s.xosc": with_parameter, **roads},
        ),
        Target(
            "scenario",
            "toml",
            ".toml",
            read_seeds("corpora/scenarios/*.toml"),
            [
                ["simulate", "{file}", "--controller", "idm"],
                ["avoid", "{file}", "--grid", "0.5"],
                ["export", "{file}", "--to", "openscenario", "--as", "actions", "--out", "out"],
            ],
        ),
        Target(
            "scenario-json",
            "json",
            ".json",
            [json.dumps(to_json(scenario)).encode()],
            [["simulate", "{file}", "--controller", "idm"]],
        ),
        Target(
            "space",
            "toml",
            ".toml",
            read_seeds("corpora/spaces/*.toml", "crates/spaces/src/built_in/*.toml"),
            [["falsify", "--controller", "idm", "--space", "{file}", "--budget", "2", "--out", "out"]],
        ),
        Target(
            "controller",
            "toml",
            ".toml",
            read_seeds(controllers + "acc.toml", controllers + "stacked.toml", controllers + "a2c.toml"),
            [run_idm],
            {name: read_seeds(controllers + name)[0] for name in ["acc-5x20.onnx", "a2c.zip"]},
        ),
        Target(
            "suite",
            "toml",
            ".toml",
            [first_clause(seed) for seed in read_seeds("crates/suites/src/shipped/*.toml")],
            [["suite", "run", "{file}", "--controller", "idm"]],
        ),
        Target(
            "assessment",
            "toml",
            ".toml",
            [SMALL_ASSESSMENT],
            [["assess", "{file}", "--out", "out"]],
            {"scenario.toml": scenario},
        ),
        Target(
            "earlier-report",
            "json",
            ".json",
            read_seeds("reports/assessment.json", limit=2_000_000),
            [["assess", "small.toml", "--against", "{file}", "--out", "out"]],
            {"small.toml": SMALL_ASSESSMENT, "scenario.toml": scenario},
        ),
        Target(
            "certificate",
            "json",
            ".json",
            read_seeds(
                "corpora/certificates/*.json", "corpora/versions/*/certificates/*.json", "corpora/fuzz/certificate/*"
            ),
            [["check", "{file}"]],
        ),
        Target(
            "run-folder",
            "json",
            ".json",
            [manifest],
            [
                ["fsck", "run"],
                [
                    "falsify",
                    "--controller",
                    "baseline",
                    "--budget",
                    "20",
                    "--space",
                    "paper",
                    "--out",
                    "run",
                    "--resume",
                ],
            ],
            campaign,
        ),
        Target("onnx", "onnx", ".onnx", read_seeds(controllers + "*.onnx"), [["describe", "{file}"], run_idm]),
        Target("sb3", "sb3", ".zip", read_seeds(controllers + "*.zip"), [["describe", "{file}"], run_idm]),
        Target(
            "statistics",
            "pickle",
            ".pkl",
            read_seeds(controllers + "normalised/*.pkl"),
            [["describe", "model.zip"], ["simulate", "paper-1", "--controller", "model.zip"]],
            {"model.zip": read_seeds(controllers + "normalised/ppo.zip")[0]},
        ),
        Target(
            "policy",
            "safetensors",
            ".safetensors",
            read_seeds("corpora/policy/*.safetensors"),
            [run_idm, ["describe", "{file}"]],
        ),
        Target("fmu", "fmu", ".fmu", [fmu, fmu_3], [["describe", "{file}"], run_idm]),
        Target(
            "fmu-description", "xml", ".xml", read_seeds("corpora/fuzz/fmu_file/fmi-*"), [["describe", "model.fmu"]]
        ),
        Target(
            "preset",
            "toml",
            ".toml",
            [preset + b"\nnonsense = 1\n" for preset in presets],
            [["train", "--preset", "{file}", "--episodes", "1", "--out", "out"]],
        ),
        Target(
            "retraining",
            "toml",
            ".toml",
            [seed + b"\nnonsense = 1\n" for seed in read_seeds("corpora/retraining/*.toml")],
            [["retrain", "--preset", "{file}", "--out", "out"]],
        ),
        Target(
            "box",
            "toml",
            ".toml",
            read_seeds("corpora/boxes/*.toml"),
            [["verify", "reach", "--controller", "policy", "--box", "{file}", "--depth", "0"]],
        ),
        Target(
            "formula", "formula", ".txt", FORMULAS, [["simulate", "paper-1", "--controller", "idm", "--spec", "{text}"]]
        ),
    ]


def first_clause(suite):
    """Returns a suite up to its second clause, so that its tests take little time."""
    parts = suite.split(b"[[clauses]]")
    return b"[[clauses]]".join(parts[:2])


def to_json(text):
    import tomllib

    return tomllib.loads(text.decode())


def run_folder(program, work):
    """Makes a campaign; returns its manifest and its other files."""
    command = [
        program,
        "-q",
        "falsify",
        "--controller",
        "baseline",
        "--space",
        "paper",
        "--budget",
        "20",
        "--out",
        work / "run",
    ]
    subprocess.run(command, check=True, capture_output=True)
    paths = [path for path in (work / "run").rglob("*") if path.is_file() and path.name != "work.json"]
    files = {str(path.relative_to(work)): path.read_bytes() for path in paths}
    return (work / "run" / "work.json").read_bytes(), files


# Runs.

PANIC = re.compile(rb"panicked at|stack overflow|RUST_BACKTRACE|internal error|AddressSanitizer|memory allocation of")


def finished_files(target, case):
    """Returns the files of a case under their final names."""
    files = dict(case.files)
    hostile = "input" + target.extension
    if target.name == "run-folder" and hostile in files:
        files["run/work.json"] = files.pop(hostile)
    if target.name == "statistics" and hostile in files:
        files["model_vecnormalize.pkl"] = files.pop(hostile)
    if target.name == "fmu-description" and hostile in files:
        files["model.fmu"] = zip_of([("modelDescription.xml", files.pop(hostile))])
    return files


def execute(program, target, case, folder, limit_s):
    """Runs a case in a folder; returns the reason of a failure or None, and the standard error."""
    folder.mkdir()
    os.mkfifo(folder / "fifo")
    (folder / "loop").symlink_to("loop")
    (folder / "folder").mkdir()
    files = finished_files(target, case)
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    text = files.get("input" + target.extension, b"")
    text = text.replace(b"\0", b"0")[:120_000]
    arguments = [
        text if part == "{text}" else part.replace("{file}", "input" + target.extension) for part in case.arguments
    ]
    temporary = folder / "temporary"
    temporary.mkdir()
    environment = {**os.environ, "TMPDIR": str(temporary), "RAYON_NUM_THREADS": "2"}
    with open(folder / "stdout", "wb") as out, open(folder / "stderr", "wb") as error:
        code, seconds, rss_bytes = LAUNCHERS.run([program, *arguments], folder, environment, (out, error), limit_s)
    error = (folder / "stderr").read_bytes()
    (folder / "command.txt").write_text(" ".join(["crumple", *map(repr, arguments)]) + "\n")
    return find_failure(code, error, seconds, limit_s, rss_bytes), error


class Launchers:
    """Small processes that start the program: Linux counts the memory of a parent among that of its children."""

    def __init__(self):
        self.local = threading.local()

    def run(self, arguments, folder, environment, streams, limit_s):
        """Runs a command; returns exit code, wall clock and processor time in seconds, and largest memory in bytes."""
        if not hasattr(self.local, "process"):
            self.local.process = subprocess.Popen(
                [sys.executable, __file__, "--launch"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
        encoded = [os.fsencode(argument).hex() for argument in arguments]
        order = {"arguments": encoded, "folder": str(folder), "environment": environment, "limit_s": limit_s}
        order["streams"] = [stream.name for stream in streams]
        process = self.local.process
        process.stdin.write(json.dumps(order) + "\n")
        process.stdin.flush()
        return json.loads(process.stdout.readline())


LAUNCHERS = Launchers()


def launch():
    """Starts the commands that standard input names, one line each, and prints their results."""
    for line in sys.stdin:
        order = json.loads(line)
        with open(order["streams"][0], "ab") as out, open(order["streams"][1], "ab") as error:
            began = time.monotonic()
            process = subprocess.Popen(
                [bytes.fromhex(argument) for argument in order["arguments"]],
                cwd=order["folder"],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=error,
                env=order["environment"],
                preexec_fn=limit_process,
            )
            killer = threading.Timer(order["limit_s"], process.kill)
            killer.start()
            _, status, usage = os.wait4(process.pid, 0)
            killer.cancel()
            process.returncode = os.waitstatus_to_exitcode(status)
        seconds = [time.monotonic() - began, usage.ru_utime + usage.ru_stime]
        print(json.dumps([process.returncode, seconds, usage.ru_maxrss * 1024]), flush=True)


def limit_process():
    resource.setrlimit(resource.RLIMIT_AS, (MAX_ADDRESS_BYTES, MAX_ADDRESS_BYTES))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30, 1 << 30))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def find_failure(code, error, seconds, limit_s, rss_bytes):
    wall_s, processor_s = seconds
    if wall_s >= limit_s:
        return f"more than {limit_s:.0f} s"
    if processor_s > MAX_SECONDS:
        return f"more than {MAX_SECONDS:.0f} s of processor time"
    if rss_bytes > MAX_RSS_BYTES:
        return f"memory: {rss_bytes / 1e6:.0f} MB"
    if code < 0:
        return f"signal {-code}"
    if code not in (0, 1, 2, 3):
        return f"exit code {code}"
    if PANIC.search(error):
        return "a text of a panic"
    if len(error) > MAX_ERROR_BYTES:
        return f"length of standard error: {len(error)} bytes"
    errors = len(re.findall(rb"^error", error, re.MULTILINE))
    if errors > 1:
        return f"{errors} errors"
    if code in (2, 3) and errors == 0:
        return f"exit code {code} without an error"
    return None


def run_one(program, readers, seed, index, work, out, alone):
    rng = random.Random(f"{seed}:{index}")
    target = readers[index % len(readers)]
    kind, case = target.case(rng)
    folder = work / f"{index:06}"
    try:
        reason, _ = execute(program, target, case, folder, MAX_SECONDS)
        if reason and reason.startswith("more than"):
            # The machine may have been busy: then the processor time decides.
            with alone:
                shutil.rmtree(folder)
                reason, _ = execute(program, target, case, folder, 6 * MAX_SECONDS)
        if reason:
            (folder / "reason.txt").write_text(f"{target.name}, {kind}: {reason}\n")
            (folder / "fifo").unlink()
            shutil.copytree(folder, out / f"{index:06}-{target.name}", symlinks=True, dirs_exist_ok=True)
        return target.name, kind, reason
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000, help="number of hostile files")
    parser.add_argument("--seed", type=int, default=0, help="seed of all files")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("hostile-failures"), help="folder of failures")
    parser.add_argument("--only", type=int, help="run only the file with this number")
    parser.add_argument("--target", action="append", help="run only files of this reader")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time")
    options = parser.parse_args()
    program = os.environ.get("CRUMPLE") or str(ROOT / "target/release/crumple")
    program = shutil.which(program)
    if program is None:
        sys.exit("error: no program: set CRUMPLE")
    program = str(pathlib.Path(program).resolve())
    options.out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="hostile-") as folder:
        work = pathlib.Path(folder)
        readers = targets(program, work)
        names = [reader.name for reader in readers]
        unknown = set(options.target or []) - set(names)
        if unknown:
            sys.exit(f"error: no reader {', '.join(sorted(unknown))}; there are {', '.join(names)}")
        indices = range(options.count) if options.only is None else [options.only]
        if options.target:
            indices = [index for index in indices if names[index % len(names)] in options.target]
        alone = threading.Lock()
        with concurrent.futures.ThreadPoolExecutor(options.jobs) as pool:
            jobs = [
                pool.submit(run_one, program, readers, options.seed, index, work, options.out, alone)
                for index in indices
            ]
            results = [job.result() for job in jobs]
    report(results, time.monotonic() - began, options.out)
    sys.exit(any(reason for _, _, reason in results))


def report(results, seconds, out):
    runs = collections.Counter(name for name, _, _ in results)
    failures = collections.Counter((name, re.sub(r"\d+", "N", reason)) for name, _, reason in results if reason)
    for name, count in runs.items():
        found = sum(number for (reader, _), number in failures.items() if reader == name)
        print(f"{name:16} {count:6} files  {found:4} failures")
    for (name, reason), count in sorted(failures.items()):
        print(f"  {name}: {reason}: {count}")
    print(f"{len(results)} files, {sum(failures.values())} failures in {out}, {seconds:.0f} s")


if __name__ == "__main__":
    launch() if sys.argv[1:] == ["--launch"] else main()
