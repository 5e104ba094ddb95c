#!/bin/sh
# Shows again what this report shows; every command may also be run by itself, in this folder. CRUMPLE names the program.
cd "$(dirname "$0")" || exit 2
crumple=${CRUMPLE:-crumple}
"$crumple" --version > /dev/null || { echo "crumple not found; use CRUMPLE=/path/to/crumple sh replay.sh" >&2; exit 2; }
failed=0
run() { "$crumple" "$@" || { echo "result differs from the report: crumple $*" >&2; failed=1; }; }
run fsck .
run check certificates/*.json
run check --rerun certificates/rate-policy.json certificates/rate-shield-policy.json certificates/rate-road.json certificates/road-against-baseline.json
run simulate counterexamples/paper/baseline/01-2-hits-1.toml --controller baseline --expect collision
run simulate counterexamples/paper/baseline/01-2-hits-1-escape.toml --expect safe
run simulate counterexamples/paper/baseline/02-2-hits-1.toml --controller baseline --expect collision
run simulate counterexamples/paper/baseline/02-2-hits-1-escape.toml --expect safe
run simulate counterexamples/paper/idm/01-2-hits-1.toml --controller idm --expect collision
run simulate counterexamples/paper/idm/01-2-hits-1-escape.toml --expect safe
run simulate counterexamples/paper/idm/02-2-hits-1.toml --controller idm --expect collision
run simulate counterexamples/paper/idm/02-2-hits-1-escape.toml --expect safe
run simulate counterexamples/paper/acc-aeb/01-2-hits-1.toml --controller acc-aeb --expect collision
run simulate counterexamples/paper/acc-aeb/01-2-hits-1-escape.toml --expect safe
run simulate counterexamples/paper/acc-aeb/02-2-hits-1.toml --controller acc-aeb --expect collision
run simulate counterexamples/paper/acc-aeb/02-2-hits-1-escape.toml --expect safe
run simulate counterexamples/paper/acc-aeb/03-2-hits-1.toml --controller acc-aeb --expect collision
run simulate counterexamples/paper/acc-aeb/03-2-hits-1-escape.toml --expect safe
run simulate counterexamples/paper/policy/01-1-hits-0.toml --controller policy --expect collision
run simulate counterexamples/paper/policy/01-1-hits-0-escape.toml --expect safe
run simulate counterexamples/paper/policy/02-1-hits-0.toml --controller policy --expect collision
run simulate counterexamples/paper/policy/02-1-hits-0-escape.toml --expect safe
run simulate counterexamples/paper/policy/03-1-hits-0.toml --controller policy --expect collision
run simulate counterexamples/paper/policy/03-1-hits-0-escape.toml --expect safe
run simulate counterexamples/paper/policy/04-1-hits-0.toml --controller policy --expect collision
run simulate counterexamples/paper/policy/04-1-hits-0-escape.toml --expect safe
run simulate counterexamples/paper/policy/05-1-hits-0.toml --controller policy --expect collision
run simulate counterexamples/paper/policy/05-1-hits-0-escape.toml --expect safe
run simulate counterexamples/paper/shield-policy/01-2-hits-1.toml --controller shield:policy --expect collision
run simulate counterexamples/paper/shield-policy/01-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/baseline/01-2-hits-1.toml --controller baseline --expect collision
run simulate counterexamples/high-risk/baseline/01-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/baseline/02-1-hits-0.toml --controller baseline --expect collision
run simulate counterexamples/high-risk/baseline/02-1-hits-0-escape.toml --expect safe
run simulate counterexamples/high-risk/baseline/03-2-hits-1.toml --controller baseline --expect collision
run simulate counterexamples/high-risk/baseline/03-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/idm/01-2-hits-1.toml --controller idm --expect collision
run simulate counterexamples/high-risk/idm/02-2-hits-1.toml --controller idm --expect collision
run simulate counterexamples/high-risk/idm/02-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/idm/03-2-hits-1.toml --controller idm --expect collision
run simulate counterexamples/high-risk/idm/03-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/idm/04-2-hits-1.toml --controller idm --expect collision
run simulate counterexamples/high-risk/idm/04-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/idm/05-2-hits-1.toml --controller idm --expect collision
run simulate counterexamples/high-risk/idm/05-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/idm/06-1-hits-0.toml --controller idm --expect collision
run simulate counterexamples/high-risk/idm/07-2-hits-1.toml --controller idm --expect collision
run simulate counterexamples/high-risk/idm/07-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/idm/08-2-hits-1.toml --controller idm --expect collision
run simulate counterexamples/high-risk/idm/08-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/idm/09-2-hits-1.toml --controller idm --expect collision
run simulate counterexamples/high-risk/idm/09-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/idm/10-1-hits-0.toml --controller idm --expect collision
run simulate counterexamples/high-risk/idm/11-2-hits-1.toml --controller idm --expect collision
run simulate counterexamples/high-risk/idm/11-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/acc-aeb/01-2-hits-1.toml --controller acc-aeb --expect collision
run simulate counterexamples/high-risk/acc-aeb/01-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/acc-aeb/02-1-hits-0.toml --controller acc-aeb --expect collision
run simulate counterexamples/high-risk/acc-aeb/02-1-hits-0-escape.toml --expect safe
run simulate counterexamples/high-risk/acc-aeb/03-2-hits-1.toml --controller acc-aeb --expect collision
run simulate counterexamples/high-risk/acc-aeb/03-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/acc-aeb/04-2-hits-1.toml --controller acc-aeb --expect collision
run simulate counterexamples/high-risk/acc-aeb/04-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/acc-aeb/05-2-hits-1.toml --controller acc-aeb --expect collision
run simulate counterexamples/high-risk/acc-aeb/05-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/acc-aeb/06-2-hits-1.toml --controller acc-aeb --expect collision
run simulate counterexamples/high-risk/acc-aeb/06-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/predictive/01-2-hits-1.toml --controller predictive --expect collision
run simulate counterexamples/high-risk/predictive/01-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/predictive/02-2-hits-1.toml --controller predictive --expect collision
run simulate counterexamples/high-risk/predictive/02-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/predictive/03-1-hits-0.toml --controller predictive --expect collision
run simulate counterexamples/high-risk/predictive/03-1-hits-0-escape.toml --expect safe
run simulate counterexamples/high-risk/predictive/04-1-hits-0.toml --controller predictive --expect collision
run simulate counterexamples/high-risk/predictive/05-1-hits-0.toml --controller predictive --expect collision
run simulate counterexamples/high-risk/predictive/05-1-hits-0-escape.toml --expect safe
run simulate counterexamples/high-risk/predictive/06-2-hits-1.toml --controller predictive --expect collision
run simulate counterexamples/high-risk/predictive/06-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/predictive/07-2-hits-1.toml --controller predictive --expect collision
run simulate counterexamples/high-risk/predictive/07-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/01-1-hits-0.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/01-1-hits-0-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/02-2-hits-1.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/03-2-hits-1.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/03-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/04-1-hits-0.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/04-1-hits-0-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/05-2-hits-1.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/05-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/06-2-hits-1.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/06-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/07-1-hits-0.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/07-1-hits-0-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/08-2-hits-1.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/08-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/09-2-hits-1.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/09-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/10-2-hits-1.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/10-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/11-2-hits-1.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/11-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/12-2-hits-1.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/12-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/policy/13-2-hits-1.toml --controller policy --expect collision
run simulate counterexamples/high-risk/policy/13-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/shield-policy/01-2-hits-1.toml --controller shield:policy --expect collision
run simulate counterexamples/high-risk/shield-policy/02-2-hits-1.toml --controller shield:policy --expect collision
run simulate counterexamples/high-risk/shield-policy/02-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/shield-policy/03-2-hits-1.toml --controller shield:policy --expect collision
run simulate counterexamples/high-risk/shield-policy/04-2-hits-1.toml --controller shield:policy --expect collision
run simulate counterexamples/high-risk/shield-policy/04-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/shield-policy/05-2-hits-1.toml --controller shield:policy --expect collision
run simulate counterexamples/high-risk/shield-policy/05-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/shield-policy/06-2-hits-1.toml --controller shield:policy --expect collision
run simulate counterexamples/high-risk/shield-policy/06-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/shield-policy/07-2-hits-1.toml --controller shield:policy --expect collision
run simulate counterexamples/high-risk/shield-policy/07-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/shield-policy/08-2-hits-1.toml --controller shield:policy --expect collision
run simulate counterexamples/high-risk/shield-policy/08-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/shield-policy/09-1-hits-0.toml --controller shield:policy --expect collision
run simulate counterexamples/high-risk/shield-policy/10-2-hits-1.toml --controller shield:policy --expect collision
run simulate counterexamples/high-risk/shield-policy/10-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/road/01-2-hits-1.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/02-2-hits-1.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/02-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/road/03-1-hits-0.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/03-1-hits-0-escape.toml --expect safe
run simulate counterexamples/high-risk/road/04-2-hits-1.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/04-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/road/05-1-hits-0.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/05-1-hits-0-escape.toml --expect safe
run simulate counterexamples/high-risk/road/06-1-hits-0.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/06-1-hits-0-escape.toml --expect safe
run simulate counterexamples/high-risk/road/07-2-hits-1.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/07-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/road/08-2-hits-1.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/08-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/road/09-2-hits-1.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/09-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/road/10-2-hits-1.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/10-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/road/11-2-hits-1.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/11-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/road/12-2-hits-1.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/12-2-hits-1-escape.toml --expect safe
run simulate counterexamples/high-risk/road/13-2-hits-1.toml --controller road --expect collision
run simulate counterexamples/high-risk/road/13-2-hits-1-escape.toml --expect safe
run simulate violations/high-risk-0-2.toml --controller road --expect collision
run simulate violations/followers-0-2.toml --controller road --expect collision
run simulate violations/everyday-0-225.toml --controller road --expect collision
run simulate violations/everyday-0-286.toml --controller road
run simulate violations/everyday-0-815.toml --controller road
exit $failed
