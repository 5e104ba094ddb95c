"""Compares the outputs of crumple-fmu and fmpy for the same inputs: `fmu.py CRUMPLE_FMU FMU...`."""

import json
import random
import shutil
import subprocess
import sys

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

STEP_S = 0.1
DECISIONS = 1000


def by_fmpy(path, inputs, output, rows):
    """Runs an FMU in fmpy; returns its output after each step."""
    description = read_model_description(path)
    folder = extract(path)
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    is_three = description.fmiVersion.startswith("3")
    slave = (FMU3Slave if is_three else FMU2Slave)(
        guid=description.guid if not is_three else description.instantiationToken,
        unzipDirectory=folder,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="one",
    )
    slave.instantiate()
    if not is_three:
        slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    set_real, get_real = (slave.setFloat64, slave.getFloat64) if is_three else (slave.setReal, slave.getReal)
    answers = []
    for number, row in enumerate(rows):
        set_real([references[name] for name in inputs], row)
        if number == 0:
            slave.exitInitializationMode()
        slave.doStep(currentCommunicationPoint=number * STEP_S, communicationStepSize=STEP_S)
        answers.append(get_real([references[output]])[0])
    slave.terminate()
    slave.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)
    return answers


def by_crumple(host, path, inputs, output, rows):
    """Runs an FMU in crumple's host; returns its output after each step."""
    wiring = [f"--input={name}" for name in inputs] + [f"--output={output}", f"--interval-s={STEP_S}"]
    hello = {"vehicle": {"index": 1}, "step_s": 0.01, "inputs": inputs, "history": 1}
    lines = [{"crumple": 1, "hello": hello}, {"id": 1, "reset": {"seed": 7}}]
    lines += [{"id": 2 + number, "time_s": number * STEP_S, "see": row} for number, row in enumerate(rows)]
    text = "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)
    ran = subprocess.run([host, "drive", *wiring, path], input=text, capture_output=True, text=True, check=True)
    return [json.loads(line)["acceleration_mps2"] for line in ran.stdout.splitlines()[2:]]


def main(host, *paths):
    """Compares the outputs of all FMUs."""
    chance = random.Random(20)
    for path in paths:
        problems = validate_fmu(path)
        assert not problems, problems
        description = read_model_description(path)
        real = ("Real", "Float64")
        variables = [variable for variable in description.modelVariables if variable.type in real]
        inputs = [variable.name for variable in variables if variable.causality == "input"]
        output = next(variable.name for variable in variables if variable.causality == "output")
        rows = [[chance.uniform(0.0, 30.0) for _ in inputs] for _ in range(DECISIONS)]
        expected, found = by_fmpy(path, inputs, output, rows), by_crumple(host, path, inputs, output, rows)
        different = sum(one != other for one, other in zip(expected, found, strict=True))
        assert len(set(expected)) > 10, "the answers are constant"
        assert not different, f"{path}: {different} of {DECISIONS} answers differ"
        name = f"{description.modelName}, FMI {description.fmiVersion}"
        print(f"{name}: valid to fmpy, {DECISIONS} bit-identical answers")


if __name__ == "__main__":
    main(*sys.argv[1:])
