#!/bin/bash
# Compares search methods by the simulations to the first failure, in the built-in spaces and five further ones.
#
#     benches/search_spaces.sh target/release/crumple FOLDER built-in|further
#
# Writes a text and a CSV file for each space to FOLDER. Takes 15 minutes on two cores.
set -euo pipefail
[ $# = 3 ] || { sed -n 's/^#     //p' "$0" >&2; exit 2; }
crumple=$(realpath "$1")
corpora=$(realpath "$(dirname "$0")/../corpora/spaces")
studies=$(realpath "$(dirname "$0")/../examples/studies")
mkdir -p "$2" && cd "$2"

compare() { # SPACE CONTROLLER NAME SEED
    "$crumple" falsify --space "$1" --controller "$2" --compare auto,cma-es,cross-entropy,uniform,halton \
        --seeds 100 --seed "$4" --budget 1000 --table "$3.csv" > "$3.txt"
}

case $3 in
built-in)
    for problem in paper:match-leader high-risk:retrained traffic:baseline standing:idm slower:idm alone:policy \
        assisted:retrained steady:policy; do
        compare "${problem%:*}" "${problem#*:}" "${problem%:*}" 50000
    done
    ;;
further)
    # A narrower range of a built-in space, or a wider one.
    "$crumple" show high-risk |
        sed 's/.* mean = 1.0, deviation = 0.25, .*/distribution.uniform = { low = 0.25, high = 0.5 }\nnominal = 0.4/' > slippery.toml
    "$crumple" show standing | sed 's/deviation = 0.1, low = 0.0, high = 0.3/deviation = 0.3, low = 0.0, high = 1.0/' > late.toml
    "$crumple" show traffic | sed 's/low = -2.5, high = 1.5/low = -4.0, high = 1.5/' > firm.toml
    compare slippery.toml predictive slippery 60000
    compare late.toml acc-aeb late 60000
    compare firm.toml policy firm 60000
    compare "$studies/emergencies.toml" road emergencies 60000
    compare "$corpora/gentle-leader.toml" match-leader gentle-leader 60000
    ;;
*)
    echo "error: built-in or further, not $3" >&2
    exit 2
    ;;
esac
