"""Answers to the questions of the study, by the rule that was committed before the run."""

import itertools
import textwrap

from drives import Stratified, change, interval, level, quantile, weights
from study import CONFORMING, HUMAN, QUESTIONS, SYSTEMS

SPACE = "emergencies"
ASSUMPTIONS = QUESTIONS["assumptions"]
RULE = QUESTIONS["rule"]
# Names of the assumptions, which the introduction of the page explains.
WORDS = {
    "hold": "hold",
    "coast": "coast",
    "kalman": "sensors",
    "truth": "true state",
    4: "4 types",
    3: "3 types",
    0: "no lorries",
    50: "half lorries",
}


def combinations(kind):
    """Returns the combinations of assumptions of a question; followers of conforming cars are human."""
    followers = [["human"]] if kind in ("conforming", "left") else ASSUMPTIONS["followers"]
    return list(itertools.product(ASSUMPTIONS["after_collision"], ASSUMPTIONS["estimator"], followers,
                                  ASSUMPTIONS["lorry_percent"]))


def comparisons():
    """Returns the number of all comparisons."""
    return sum(len(combinations(one["kind"])) * len(one.get("after", [0])) for one in QUESTIONS["questions"])


def z():
    return quantile(RULE["error_probability"] / comparisons())


def number(value, is_signed=False, digits=1):
    """Returns a value without a negative zero."""
    text = f"{value:+.{digits}f}" if is_signed else f"{value:.{digits}f}"
    return text.lstrip("+-") if float(text) == 0 else text.replace("-", "−")


def extent(values, is_signed=True, digits=1):
    """Returns the smallest and the largest of some values."""
    low, high = (number(value, is_signed, digits) for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def conforming_values(part, is_ego_conforming, is_follower_conforming, measure):
    """Returns a measure of the drives of human followers; lorries never have the brake."""
    system = CONFORMING if is_ego_conforming else HUMAN
    alone = part["followers-alone", system]
    cars = part["followers-conforming", system] if is_follower_conforming else alone
    of_class = {kind: getattr(drives, measure) for kind, drives in (("light", cars), ("heavy", alone))}
    return [of_class[stratum[1]][place] for place, stratum in enumerate(alone.strata)]


def is_easy(drives, place):
    """Returns true for a dry road, and a speed at which the tests have no manual braking."""
    return drives.friction[place] >= 0.9 and drives.speed_mps[place] <= 80 / 3.6


def conforming_level(part, share, measure, of, is_wanted=lambda *_: True):
    """Returns a measure, and its error, if this share of the cars has the brake, independently of each other."""
    values = {pair: conforming_values(part, *pair, measure) for pair in itertools.product((False, True), repeat=2)}
    alone = part["followers-alone", HUMAN]
    probability = {True: share, False: 1 - share}
    places = [place for place in range(len(alone.strata)) if is_wanted(alone, place)]
    mixed = [sum(probability[ego] * probability[follower] * values[ego, follower][place] for ego, follower in values)
             for place in places]
    return Stratified([alone.strata[place] for place in places], mixed, measure).mean(of)


def conforming_change(part, measure, of):
    pairs = zip(conforming_values(part, True, True, measure), conforming_values(part, False, False, measure))
    strata = part["followers-alone", HUMAN].strata
    return Stratified(strata, [after - before for after, before in pairs], measure).mean(of)


def assisted_systems():
    """Returns the human driver, and all human drivers with a brake, by threshold."""
    return [HUMAN] + [name for name in SYSTEMS if name.startswith("human,aeb_ttc_s=")]


def threshold_s(name):
    return float(name.split("=")[1]) if "=" in name else 0.0


def relative_change(part, name, measure, of):
    """Returns the change of a measure against a human without a brake in percent, and its error (delta method)."""
    own, alone = part[SPACE, name], part[SPACE, HUMAN]
    means = [level(drives, measure).mean(of)[0] for drives in (own, alone)]
    ratio = means[0] / means[1]
    linear = [after - ratio * before for after, before in zip(getattr(own, measure), getattr(alone, measure))]
    error = 100 * Stratified(own.strata, linear, measure, has_floor=False).mean(of)[1] / means[1]
    return 100 * (ratio - 1), error


def relative_curve(part, of):
    """Returns (threshold, change of striking, change of being struck) against a human without a brake, in percent."""
    return [(threshold_s(name), *(relative_change(part, name, measure, of)[0] for measure in ("ahead", "behind")))
            for name in assisted_systems()]


def struck_where(means, striking):
    """Returns the part of the way between two thresholds at which striking has this change, and the change of being
    struck there. `means` are striking, then being struck: without a brake, at the lower and at the upper threshold."""
    ahead, behind = ([value / of[0] - 1 for value in of[1:]] for of in (means[:3], means[3:]))
    way = (ahead[0] - striking) / (ahead[0] - ahead[1])
    return way, behind[0] + way * (behind[1] - behind[0])


def field_point(part, of, question, has_floor):
    """Returns the threshold, and the change of being struck in percent with its standard error (delta method).

    `has_floor` applies the smallest variance of a count, as the script did by mistake before the run.
    """
    striking = question["striking"]
    curve = list(zip(assisted_systems(), relative_curve(part, of)))
    for (below, (low_s, low, _)), (above, (high_s, high, _)) in zip(curve, curve[1:]):
        if low >= 100 * striking > high:
            break
    else:
        return None
    values = [getattr(part[SPACE, name], measure) for measure in ("ahead", "behind") for name in (HUMAN, below, above)]
    strata = part[SPACE, HUMAN].strata
    means = [Stratified(strata, of_system, "ahead").mean(of)[0] for of_system in values]
    way, struck = struck_where(means, striking)
    slopes = []
    for place, mean in enumerate(means):
        step = 1e-4 * mean
        higher, lower = (struck_where([*means[:place], mean + sign * step, *means[place + 1:]], striking)[1]
                         for sign in (1, -1))
        slopes.append((higher - lower) / (2 * step))
    linear = [sum(slope * value for slope, value in zip(slopes, row)) for row in zip(*values)]
    error = Stratified(strata, linear, "ahead", has_floor=has_floor).mean(of)[1]
    return low_s + way * (high_s - low_s), (100 * struck, 100 * error)


def compare(question, results, has_floor=False):
    """Returns {(system, combination): (mean, lower, upper)}, and the thresholds of a question about the field."""
    found, thresholds = {}, []
    for combination in combinations(question["kind"]):
        after_collision, estimator, followers, lorries = combination
        part, of = results[after_collision, estimator], weights(followers, lorries)
        key = (after_collision, estimator, len(followers), lorries)
        if question["kind"] == "change":
            for name in question["after"]:
                changed = change(part[SPACE, name], part[SPACE, question["before"]], question["measure"])
                found[name, key] = interval(changed.mean(of), z())
        elif question["kind"] == "conforming":
            found["all", key] = interval(conforming_change(part, "any", of), z())
        elif question["kind"] == "left":
            found["all", key] = interval(conforming_level(part, 1.0, "any", of), z())
        else:
            point = field_point(part, of, question, has_floor)
            if point:
                thresholds.append(point[0])
                found["all", key] = interval(point[1], z())
    return found, thresholds


def side(bounds, reference=0.0):
    """Returns 1 or -1 if an interval lies on one side of the reference, otherwise 0."""
    return int(bounds[1] > reference) - int(bounds[2] < reference)


def holds(conjunction, combination):
    """Returns true if a combination has all values of a conjunction; `None` stands for any value."""
    return all(value in (None, own) for value, own in zip(conjunction, combination))


def length(conjunctions):
    """Returns the number of values that some conjunctions name."""
    return sum(value is not None for conjunction in conjunctions for value in conjunction)


def cover(combinations_of_all, wanted):
    """Returns the shortest list of conjunctions of assumptions that hold in exactly the wanted combinations."""
    values = [[None, *dict.fromkeys(of)] for of in zip(*combinations_of_all)]
    held = {conjunction: {one for one in combinations_of_all if holds(conjunction, one)}
            for conjunction in itertools.product(*values)}
    inside = [one for one in held if held[one] and held[one] <= wanted]
    largest = [one for one in inside if not any(held[one] < held[other] for other in inside)]
    covers = (chosen for count in range(1, len(largest) + 1) for chosen in itertools.combinations(largest, count)
              if set().union(*(held[one] for one in chosen)) == wanted)
    first = next(covers)
    shortest = min([first, *itertools.takewhile(lambda chosen: len(chosen) == len(first), covers)], key=length)
    return sorted(shortest, key=lambda conjunction: [value is None for value in conjunction])


def in_words(conjunctions, start):
    """Returns conjunctions as a phrase."""
    parts = []
    for conjunction in conjunctions:
        *first, last = [f"*{WORDS[value]}*" for value in conjunction if value is not None]
        parts.append(f"{', '.join(first)} and {last}" if first else last)
    return f"{start} " + ", or with ".join(parts)


def condition(sides, wanted):
    """Returns the assumptions under which combinations have the wanted side, as a phrase; empty if all have it."""
    own = {key for key, value in sides.items() if value == wanted}
    if len(own) == len(sides):
        return ""
    only, unless = cover(list(sides), own), cover(list(sides), set(sides) - own)
    return in_words(unless, "except with") if len(unless) < len(only) else in_words(only, "with")


def conditional(sides, words):
    """Returns each answer that some combinations have, with its condition."""
    return "; ".join(f"{word} {condition(sides, wanted)}".strip() for wanted, word in words.items()
                     if wanted in sides.values()) or "every interval contains 0"


def spans(found, is_signed=True, digits=1):
    """Returns the extent of the values, and that of the ends of their intervals."""
    ends = [end for bounds in found.values() for end in bounds[1:]]
    low, high = (number(end, is_signed, digits) for end in (min(ends), max(ends)))
    return extent([bounds[0] for bounds in found.values()], is_signed, digits), f"{low}…{high}"


CHANGES = {1: "more", -1: "fewer"}
NO_ANSWER = "No common answer"


def verdict(found, limit):
    """Returns the answer of one comparison in all combinations."""
    sides = {key: side(bounds) for key, bounds in found.items()}
    span, ends = spans(found)
    values = f"{span} ({ends})."
    for wanted, word in CHANGES.items():
        if all(value == wanted for value in sides.values()):
            return f"{word.capitalize()}: {values}"
    if limit and all(-limit < bounds[1] and bounds[2] < limit for bounds in found.values()):
        return f"The change is less than {limit:g}: {values}"
    return f"{NO_ANSWER} ({conditional(sides, CHANGES)}): {values}"


def group(found):
    """Returns {system: {combination: bounds}}."""
    by_system = {}
    for (name, key), bounds in found.items():
        by_system.setdefault(name, {})[key] = bounds
    return by_system


def answer_of_change(question, by_system):
    if len(by_system) == 1:
        return verdict(*by_system.values(), RULE["limit"][question["measure"]])
    systems = {}
    for name, found in by_system.items():
        sides = {key: side(bounds) for key, bounds in found.items()}
        systems.setdefault(conditional(sides, CHANGES), []).append(f"`{name}`")
    most = max(systems, key=lambda parts: len(systems[parts]))
    others = "".join(f"; {', '.join(names)}: {parts}" for parts, names in systems.items() if parts != most)
    span, ends = spans({(name, key): bounds for name, found in by_system.items() for key, bounds in found.items()})
    count = sum(verdict(found, RULE["limit"][question["measure"]]).startswith(NO_ANSWER)
                for found in by_system.values())
    return (f"{NO_ANSWER} for {count} of {len(by_system)} models of these cars, extrapolated here "
            f"({len(systems[most])} of them: {most}{others}): {span} ({ends}).")


def answer_of_left(question, found):
    span, ends = spans(found, False)
    is_left = all(bounds[1] > question["limit"] for bounds in found.values())
    word = "No" if is_left else NO_ANSWER
    return (f"{word}, in these emergencies, which go beyond the tests: {span} ({ends}) still end in a collision; the "
            f"limit is {question['limit']:g}.")


def answer_of_field(question, results, found, thresholds):
    """Returns the answer about the field, and the one of the script as it was committed before the run."""
    if len(found) < len(combinations("field")):
        return "No answer: in some combinations no threshold up to 3 s halves the collisions ahead."
    reported = 100 * question["struck"]
    sides = {key: side(bounds, reported) for key, bounds in found.items()}
    parts = conditional(sides, {-1: "lower", 1: "higher"})
    span, ends = spans(found, digits=0)
    committed = group(compare(question, results, has_floor=True)[0])["all"]
    agree = sum(side(bounds, reported) == 0 for bounds in committed.values())
    changed = (f"**Changed after the run**: the first script, by a fault, had wider intervals "
               f"({spans(committed, digits=0)[1]} %), {agree} of {len(committed)} around +{reported:.0f} %.")
    return (f"{NO_ANSWER} ({parts}): {span} % "
            f"({ends} %), at {extent(thresholds, False)} s. {changed}")


def answer(question, results):
    """Returns the sentence that answers a question."""
    found, thresholds = compare(question, results)
    by_system, kind = group(found), question["kind"]
    if kind == "change":
        return answer_of_change(question, by_system)
    if kind == "conforming":
        return verdict(by_system["all"], 0)
    if kind == "left":
        return answer_of_left(question, by_system["all"])
    return answer_of_field(question, results, by_system.get("all", {}), thresholds)


def repeated(results, others):
    """Returns the number of comparisons with the same side in both runs, and that of all.

    Sides are those of 0, of the limit of the collisions that are left, or of the field's value.
    """
    counts = [0, 0]
    for question in QUESTIONS["questions"]:
        reference = {"left": question.get("limit"), "field": 100 * question.get("struck", 0)}.get(question["kind"], 0)
        first, second = (compare(question, of)[0] for of in (results, others))
        counts[0] += sum(key in second and side(bounds, reference) == side(second[key], reference)
                         for key, bounds in first.items())
        counts[1] += len(first)
    return counts


def all_answers(results):
    """Returns the list of questions with their answers."""
    lines = [f"{place}. **{question['text']}** {answer(question, results)}"
             for place, question in enumerate(QUESTIONS["questions"], 1)]
    return [textwrap.fill(line, 140, subsequent_indent="   ", break_long_words=False, break_on_hyphens=False)
            for line in lines]


def systems_answers(results):
    """Returns a row for each system of the question about several: its answers by the motion after an impact."""
    question = next(one for one in QUESTIONS["questions"] if len(one.get("after", [])) > 1)
    rows = []
    for name, found in group(compare(question, results)[0]).items():
        row = [f"`{name}`"]
        for after_collision in ASSUMPTIONS["after_collision"]:
            part = {key: bounds for key, bounds in found.items() if key[0] == after_collision}
            sides = {key: side(bounds) for key, bounds in part.items()}
            row += [conditional(sides, CHANGES), "{} ({})".format(*spans(part))]
        rows.append(row)
    return rows
