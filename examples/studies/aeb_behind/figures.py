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
    """Returns all tables; the page has the one named `all`."""
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
        (label(name), passing.get(name, "–"), share(sum(one.ahead), one.count), share(sum(one.behind), one.count))
        for name, one in every.items()
    ]
    harmed = [(label(name), *(harm(name, before, groups[group]) for group, before in injuries)) for name in every]
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
        "all": table(["system", "passes modelled tests", "hits vehicle ahead, %", "hit from behind, %"],
                     everything),
        "injuries": table(["system", *(f"seriously injured, {group} behind, change per 1000 against {label(before)}"
                                       for group, before in injuries)], harmed),
        "parts": table(["vehicle behind, or speed", "emergencies", *(
            f"{pair}: {what}" for pair in ("human + brake 1.4 s against human", f"brake 3 s against {label(REFERENCE)}")
            for what in CHANGED)], parts),
        "activations": table(["system", "activations", f"avoided ahead against {label(REFERENCE)}",
                              f"caused behind against {label(REFERENCE)}",
                              f"change behind against {label(REFERENCE)}", f"change behind against {label(COASTING)}",
                              f"change of seriously injured against {label(REFERENCE)}"], activations),
        "hours": table(["change", "hits ahead", "hit from behind", "seriously injured"], hourly),
    }


def statements(groups):
    """Returns the sentences of the page that have figures of the runs."""
    every = groups["all"]
    slowest, fastest = min(every[HUMAN].speed), max(every[HUMAN].speed)
    collides = all(all(every[name].ahead) for name in (REFERENCE, COASTING))
    fewest = all(sum(every["predictive"].ahead) < sum(one.ahead) and sum(every["predictive"].behind) < sum(one.behind)
                 for name, one in every.items() if name != "predictive")
    lorries = sum(one[HUMAN].count for name, one in groups.items() if name.endswith(" heavy"))
    escapes, _, examined = every[REFERENCE].avoidable
    types = ", ".join(f"{groups[name][HUMAN].count} `{name}`" for name in FOLLOWERS)
    if not (collides and fewest):
        sys.exit("error: a statement of the page does not hold")
    return [
        f"hit the vehicle ahead in {number(100 * sum(every['predictive'].ahead) / every[HUMAN].count)} and "
        f"{number(100 * sum(every['road'].ahead) / every[HUMAN].count)} % and are hit from behind in "
        f"{number(100 * sum(every['predictive'].behind) / every[HUMAN].count)} and "
        f"{number(100 * sum(every['road'].behind) / every[HUMAN].count)} %",
        f"`predictive` has the fewest of both among all {len(every)} systems",
        f"With human followers `road` and `predictive` do not differ distinguishably (injuries: "
        f"{signed(groups['human']['road'].change(groups['human']['predictive'], 'harm'))} per 1000)",
        f"In {escapes} of the first {examined} emergencies",
        f"at least {number(100 * clopper_pearson(escapes, examined)[0])} %",
        f"{every[HUMAN].count} emergencies ({types}; {lorries} of them lorries)",
        f"Speeds are {3.6 * slowest:.0f} to {3.6 * fastest:.0f} km/h "
        f"({slowest / MPH:.0f} to {fastest / MPH:.0f} mph)",
        f"In {sum(every[REFERENCE].active)} of {every[REFERENCE].count} drives noise makes the first reference brake "
        f"shortly before its impact",
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
