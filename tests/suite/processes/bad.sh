# A misbehaving controller: bad.sh WHAT MARK. MARK identifies its processes.
what=$1
say() { printf '%s\n' "$1"; }
# Starts a process that does not end by itself, with the mark in its command line.
linger() { sh -c 'trap "" HUP INT TERM; while :; do sleep 1; done' "$1" </dev/null; }

echo "begins to $what" >&2
read -r hello
more=
case $what in
    end-early) exit 3 ;;
    sleep-early) linger "$2" ;;
    babble) say hello && exit ;;
    list) say '[1,"bad",true]' && exit ;;
    other-version) say '{"crumple":2,"name":"bad"}' && exit ;;
    other-inputs) more=',"inputs":7' ;;
    negative-interval) more=',"interval_s":-1' ;;
    odd-interval) more=',"interval_s":0.015' ;;
    miscount | miss-one-of-many) more=',"batch":true' ;;
    *) ;;
esac
claim=true
[ "$what" = admit ] && claim=false
say "{\"crumple\":1,\"name\":\"bad\",\"deterministic\":$claim$more}"
asked=0
runs=0
while read -r line; do
    id=${line#'{"id":'}
    id=${id%%,*}
    case $line in
        *reset*)
            asked=0
            runs=$((runs + 1))
            if [ "$what" = not-ready ]; then say "{\"id\":$id,\"ready\":false}"; else say "{\"id\":$id,\"ready\":true}"; fi
            continue
            ;;
        *hello*) say "{\"crumple\":1,\"name\":\"bad\",\"deterministic\":$claim$more}" && continue ;;
    esac
    asked=$((asked + 1))
    answer=-1.25
    if [ "$asked" -eq 4 ]; then
        echo "will $what" >&2
        case $what in
            crash) kill -s SEGV $$ ;;
            end) exit 7 ;;
            sleep) linger "$2" ;;
            fork)
                linger "$2" &
                linger "$2" &
                exit 7
                ;;
            close)
                exec 0<&- 1>&-
                linger "$2" 2>&-
                ;;
            flood) while :; do printf '%s' xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx; done ;;
            chatter) say "{\"id\":$id,\"acceleration_mps2\":-1}" ;;
            not-a-number) answer=NaN ;;
            exceed) answer=31 ;;
            leave-out) say "{\"id\":$id}" && continue ;;
            *) ;;
        esac
    fi
    case $what in
        differ | admit) answer=-1.$$ ;;
        remember) answer=-1.$runs ;;
        remember-late) [ "$runs" -gt 6 ] && answer=-1.3 ;;
        miscount) answer="[$answer,$answer]" ;;
        *) ;;
    esac
    say "{\"id\":$id,\"acceleration_mps2\":$answer}"
done
[ "$what" = stay ] && linger "$2"
