"""Tables and statements of the page of the study."""

import re
import sys

from drives import (ASSISTED, ASSISTED_EARLY, BRAKE, CHANGED, CLASSES, COASTING, EARLY, FOLLOWERS, HUMAN, MPH,
                    REFERENCE, SHOWN, clopper_pearson, label)


def number(value, is_signed=False, digits=1):
    """Returns a value without a negative zero."""
    text = f"{value:+.{digits}f}" if is_signed else f"{value:.{digits}f}"
    return text.lstrip("+-") if float(text) == 0 else text.replace("-", "−")


def share(count, of):
    """Returns a percentage with its exact interval."""
    values = [100 * value for value in (count / max(of, 1), *clopper_pearson(count, of))]
    digits = 0 if 9.95 <= values[0] < 99.5 else 1
    mean, low, high = (number(value, digits=digits) for value in values)
    return f"{mean} ({low}…{high})"


def signed(values, digits=1):
    mean, low, high = (number(value, True, digits) for value in values)
    return f"{mean} ({low}…{high})"


def table(columns, rows):
    lines = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows])


def arrow(before, after, what):
    """Returns the shares, or the harm, of two controllers."""
    if what == "harm":
        return " → ".join(number(1000 * sum(one.harm) / one.count) for one in (before, after))
    return " → ".join(number(100 * sum(getattr(one, what)) / one.count, digits=0) for one in (before, after))


def by_follower(groups):
    return [(f"`{name}`", groups[name]) for name in FOLLOWERS] + [("all four", groups["all"])]


def tables(groups, passing, rate):
    """Returns the tables of the page."""
    every = groups["all"]
    reference, coasting = every[REFERENCE], every[COASTING]
    harm = lambda name, before, one: (f"level {number(1000 * sum(one[name].harm) / one[name].count)}"
                                      if name == before else signed(one[name].change(one[before], "harm")))
    assisted = [
        (text, brake, arrow(one[HUMAN], one[name], "ahead"), arrow(one[HUMAN], one[name], "behind"),
         signed(one[name].change(one[HUMAN], "behind")),
         *(share(count, one[HUMAN].count) for count in one[name].only("behind", one[HUMAN])),
         arrow(one[HUMAN], one[name], "harm"), signed(one[name].change(one[HUMAN], "harm")))
        for text, one in by_follower(groups) for brake, name in (("1.4 s", ASSISTED), ("3 s", ASSISTED_EARLY))
    ]
    alone = [
        (text, brake, *(signed(one[name].change(one[before], what))
                        for what in ("behind", "harm") for before in (REFERENCE, COASTING)))
        for text, one in by_follower(groups) for brake, name in (("1.4 s", BRAKE), ("3 s", EARLY))
    ]
    assisted_heads = ["vehicle behind", "brake from", "hits vehicle ahead, %: human → human + brake",
                      "hit from behind, %: human → human + brake", f"{CHANGED[0]} against human",
                      "caused against human, %", "prevented against human, %",
                      "seriously injured per 1000: human → human + brake", f"{CHANGED[1]} against human"]
    alone_heads = ["vehicle behind", "brake from",
                   *(f"{what} against {label(before)}" for what in CHANGED for before in (REFERENCE, COASTING))]
    injuries = [("all", REFERENCE), ("human", REFERENCE), ("baseline", REFERENCE), ("baseline", COASTING)]
    everything = [
        (label(name), passing.get(name, "–"), share(sum(one.ahead), one.count), share(sum(one.behind), one.count),
         share(sum(b and not a for a, b in zip(one.ahead, one.behind)), one.count),
         *(harm(name, before, groups[group]) for group, before in injuries))
        for name, one in every.items()
    ]
    activations = []
    for name in SHOWN[2:]:
        one = every[name]
        active = sum(one.active)
        caused = one.during_activations("behind", reference)[0]
        activations.append((label(name), active, share(one.during_activations("ahead", reference)[1], active),
                            share(caused, active),
                            signed(one.change(reference, "behind", True)),
                            signed(one.change(coasting, "behind", True)),
                            signed([value / 10 for value in one.change(reference, "harm", True)], 2)))
    subsets = [(f"`{driver}`, {word}", groups.get(f"{driver} {kind}")) for driver in FOLLOWERS
               for kind, word in CLASSES.items()]
    subsets += [(name, groups.get(name)) for name in ("car", "lorry", "up to 62 mph", "above 62 mph")]
    parts = [
        (name, one[HUMAN].count, *(signed(one[after].change(one[before], what))
         for before, after in ((HUMAN, ASSISTED), (REFERENCE, EARLY)) for what in ("behind", "harm")))
        for name, one in subsets if one
    ]
    hourly = [
        (f"{label(before)} → {label(after)}", *(signed([scale * rate * value for value in
                                                        every[after].change(every[before], what)])
                                                for what, scale in (("ahead", 10), ("behind", 10), ("harm", 1))))
        for before, after in ((HUMAN, ASSISTED), (REFERENCE, EARLY), (COASTING, EARLY))
    ]
    return {
        "assisted, all": table(assisted_heads[1:], [row[1:] for row in assisted[-2:]]),
        "alone, all": table(alone_heads[1:], [row[1:] for row in alone[-2:]]),
        "assisted": table(assisted_heads, assisted[:-2]),
        "alone": table(alone_heads, alone[:-2]),
        "all": table(["system", "passes modelled tests", "hits vehicle ahead, %", "hit from behind, %",
                      "only hit from behind, %", *(
                          f"seriously injured, {group} behind, change per 1000 against {label(before)}"
                          for group, before in injuries)], everything),
        "parts": table(["vehicle behind, or speed", "emergencies", *(
            f"{pair}: {what}" for pair in ("human + brake 1.4 s against human", f"brake 3 s against {label(REFERENCE)}")
            for what in CHANGED)], parts),
        "activations": table(["system", "activations", f"avoided ahead against {label(REFERENCE)}",
                              f"caused behind against {label(REFERENCE)}",
                              f"change behind against {label(REFERENCE)}", f"change behind against {label(COASTING)}",
                              f"change of seriously injured against {label(REFERENCE)}"], activations),
        "hours": table(["change", "hits ahead", "hit from behind", "seriously injured"], hourly),
    }


def statements(groups, passing):
    """Returns the sentences of the page that have figures of the runs."""
    every = groups["all"]
    of = lambda name, what, group="all": number(
        (1000 if what == "harm" else 100) * sum(getattr(groups[group][name], what)) / groups[group][name].count,
        digits=1 if what == "harm" else 0)
    change = lambda before, after, what, group="all": signed(groups[group][after].change(groups[group][before], what))
    fixed = [name for name in every if name.startswith(BRAKE) and name not in (REFERENCE, COASTING)]
    passed, failed = ([name for name in fixed if passing.get(name) == verdict] for verdict in ("yes", "no"))
    interval = lambda after, before, group: groups[group][after].change(groups[group][before], "harm")
    span = lambda names: " to ".join(
        number(end(interval(name, REFERENCE, "all")[0] for name in names), True) for end in (max, min))
    slowest, fastest = min(every[HUMAN].speed), max(every[HUMAN].speed)
    collides = all(all(every[name].ahead) for name in (REFERENCE, COASTING))
    fewest = all(sum(every["predictive"].ahead) < sum(one.ahead) and sum(every["predictive"].behind) < sum(one.behind)
                 for name, one in every.items() if name != "predictive")
    lorries = sum(one[HUMAN].count for name, one in groups.items() if name.endswith(" heavy"))
    escapes, _, examined = every[REFERENCE].avoidable
    early = [not a and b for a, b in zip(every[EARLY].ahead, every[EARLY].behind)]
    both = sum(hit and before for hit, before in zip(early, every[REFERENCE].behind))
    types = ", ".join(f"{groups[name][HUMAN].count} `{name}`" for name in FOLLOWERS)
    gain = lambda group, after=ASSISTED: change(HUMAN, after, "harm", group)
    behind = lambda group, before, *brakes: "/".join(change(before, one, "behind", group).split()[0] for one in brakes)
    changes = [behind(group, before, BRAKE) for group in FOLLOWERS for before in (REFERENCE, COASTING)]
    value = lambda text: float(text.replace("−", "-"))
    with_cars, with_lorries = (interval(ASSISTED, HUMAN, group)[0] for group in ("car", "lorry"))
    lorry = groups["baseline heavy"]
    rise = lambda after: sum(every[after].harm) / sum(every[HUMAN].harm) - 1
    part = lambda group, after: number(
        1000 * (sum(group[after].harm) - sum(group[HUMAN].harm)) / every[HUMAN].count, True, 2)
    saves = all(interval(name, before, group)[2] < 0 for name in fixed for before in (REFERENCE, COASTING)
                for group in ("human", "acc-aeb", "idm"))
    adds = [sum(all(interval(name, before, "baseline")[1] > 0 for before in (REFERENCE, COASTING)) for name in names)
            for names in (passed, failed)]
    spares = sum(all(interval(name, before, "baseline")[2] < 0 for before in (REFERENCE, COASTING)) for name in fixed)
    if not (collides and fewest and saves):
        sys.exit("error: a statement of the page does not hold")
    return [
        f"each of the {len(fixed)} brakes evaluated saves injuries in front of `human`, `acc-aeb` and `idm`",
        f"{adds[0]} of the {len(passed)} that pass and {adds[1] or 'none'} of the {len(failed)} that fail add injuries "
        f"under both references (95 % interval above zero); {spares or 'none'} of the {len(fixed)} saves injuries "
        f"under both",
        f"collisions change by {min(changes, key=value)} to {max(changes, key=value)} per 100",
        f"hits the vehicle ahead in {of(ASSISTED, 'ahead')} instead of {of(HUMAN, 'ahead')} % of the emergencies, and "
        f"is hit from behind in {of(ASSISTED, 'behind')} instead of {of(HUMAN, 'behind')} % "
        f"(change {change(HUMAN, ASSISTED, 'behind')} per 100)",
        f"The expected number of seriously injured drivers changes by {change(HUMAN, ASSISTED, 'harm')} per 1000",
        f"{gain('car')} per 1000 with a car behind and {gain('lorry')} with a lorry",
        f"{gain('up to 62 mph')} up to 62 mph and {gain('above 62 mph')} above",
        f"their {lorry[HUMAN].count} emergencies alone add {part(lorry, ASSISTED)} per 1000 to a total of "
        f"{part(every, ASSISTED)} (brake from 3 s: {part(lorry, ASSISTED_EARLY)} of {part(every, ASSISTED_EARLY)})",
        f"injuries would fall if fewer than {100 * with_cars / (with_cars - with_lorries):.0f} % of the vehicles "
        f"behind were lorries, instead of {100 * lorries / every[HUMAN].count:.0f} %",
        f"(+{100 * rise(ASSISTED):.0f} % with a brake from 1.4 s, "
        f"+{100 * rise(ASSISTED_EARLY):.0f} % from 3 s)",
        f"by {gain('without baseline')} with the 1.4 s brake and by {gain('without baseline', ASSISTED_EARLY)} with",
        f"rise more with cars ({behind('car', HUMAN, ASSISTED)} per 100) than with lorries "
        f"({behind('lorry', HUMAN, ASSISTED)})",
        f"the 1.4 s brake changes injuries by {gain('human')} per 1000 in this sample",
        f"From 3 s, it adds {change(HUMAN, ASSISTED_EARLY, 'behind')} collisions behind per 100, and injuries change "
        f"by {change(HUMAN, ASSISTED_EARLY, 'harm')} per 1000",
        f"Of the {len(fixed)} rows `brake …` without a driver, the {len(passed)} that pass change injuries by "
        f"{span(passed)} per 1000, the {len(failed)} that fail by {span(failed)}",
        f"`openpilot`, outside these rows, fails, yet changes them by {change(REFERENCE, 'openpilot', 'harm')}",
        f"hit the vehicle ahead in {number(100 * sum(every['predictive'].ahead) / every[HUMAN].count)} and "
        f"{number(100 * sum(every['road'].ahead) / every[HUMAN].count)} % and are hit from behind in "
        f"{number(100 * sum(every['predictive'].behind) / every[HUMAN].count)} and "
        f"{number(100 * sum(every['road'].behind) / every[HUMAN].count)} %",
        f"`predictive` has the fewest of both among all {len(every)} systems",
        f"With human followers `road` and `predictive` do not differ distinguishably (injuries: "
        f"{change('predictive', 'road', 'harm', 'human')} per 1000)",
        f"In {escapes} of the first {examined} emergencies",
        f"at least {number(100 * clopper_pearson(escapes, examined)[0])} %",
        f"{every[HUMAN].count} emergencies ({types}; {lorries} of them lorries)",
        f"In {sum(early)} of {len(early)} emergencies brake 3 s, 7.5 m/s² avoids the vehicle ahead and is hit from "
        f"behind; in {both} of these the car without a brake, which brakes after its impact, is hit, too",
        f"Speeds are {3.6 * slowest:.0f} to {3.6 * fastest:.0f} km/h "
        f"({slowest / MPH:.0f} to {fastest / MPH:.0f} mph)",
        f"In {sum(every[REFERENCE].active)} of {len(early)} drives noise makes the first reference brake shortly "
        f"before its impact",
        f"`openpilot` has no activation in {every['openpilot'].active.count(False)} drives",
    ]


def check_page(page, made, sentences, is_written):
    """Compares the tables and the figures of the text with the page, or writes the tables."""
    text = page.read_text()
    for name, block in made.items():
        head = block.split("\n")[0]
        old = re.search(re.escape(head) + r"\n(?:\|.*\n)+", text)
        if old is None:
            sys.exit(f"error: {page} has no table `{name}` with the head {head}")
        if old[0] != block + "\n" and not is_written:
            rows = zip(old[0].splitlines(), block.splitlines())
            sys.exit(f"error: table `{name}` of {page} differs: " + str(next((a, b) for a, b in rows if a != b)))
        text = text.replace(old[0], block + "\n")
    if is_written:
        page.write_text(text)
    words = " ".join(text.split())
    missing = [sentence for sentence in sentences if " ".join(sentence.split()) not in words]
    if missing:
        sys.exit(f"error: {page} does not state:\n" + "\n".join(missing))
    cells = sum(block.count("|") - block.count("\n") for block in made.values())
    print(f"{len(made)} tables with {cells} cells and {len(sentences)} statements of the page agree with the runs.")
