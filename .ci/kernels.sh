#!/usr/bin/env bash
# The tests as other machines would run them: beside busy loops, and with the math kernels of other processors.
#
#   kernels.sh [CONDITION...] [-- PYTEST ARGUMENTS]     every condition, or those named (see `conditions` below)
#
# Prints a table and leaves what each run said in OUT (runs/kernels). Fails where a test does. Wants the environment of
# `make setup`. What the processor cannot do is skipped: kernels can only be asked for, not lent.
set -euo pipefail
cd "$(dirname "$0")/.."
OUT=${OUT:-runs/kernels}
PY=${PY:-.venv/bin/python}

conditions=(plain busy haswell zen skylakex aten-default aten-avx2 numba-generic)
chosen=()
while [ $# -gt 0 ] && [ "$1" != -- ]; do chosen+=("$1"); shift; done
[ $# -eq 0 ] || shift
[ $# -gt 0 ] || set -- -n 2
[ ${#chosen[@]} -gt 0 ] || chosen=("${conditions[@]}")

loops=()
end_loops() {
	for loop in "${loops[@]}"; do kill "$loop" 2>/dev/null || true; done
	loops=()
}
trap end_loops EXIT
trap 'exit 130' INT TERM

has() { for flag; do grep -qw "$flag" /proc/cpuinfo || return 1; done; }

# What the condition sets, one word each; 1 where this processor cannot.
setting() {
	case $1 in
	plain) ;;
	busy) ;;
	haswell) has avx2 fma && echo OPENBLAS_CORETYPE=Haswell ;;
	zen) has avx2 fma && echo OPENBLAS_CORETYPE=Zen ;;
	skylakex) has avx512f avx512bw avx512dq avx512vl avx512cd && echo OPENBLAS_CORETYPE=SkylakeX ;;
	aten-default) echo ATEN_CPU_CAPABILITY=default ;;
	aten-avx2) has avx2 fma && echo ATEN_CPU_CAPABILITY=avx2 ;;
	# What numba keeps compiled is for the processor that it was told of: a folder of its own.
	numba-generic) echo NUMBA_CPU_NAME=generic && echo "NUMBA_CACHE_DIR=$PWD/$OUT/numba" ;;
	*) echo "kernels.sh: no condition '$1'; there are: ${conditions[*]}" >&2 && exit 2 ;;
	esac
}

# The number before such a word in pytest's last line, 0 where there is none.
counted() { sed -nE "s/.*\b([0-9]+) $1.*/\1/p" <<<"$2" | awk '{ sum += $1 } END { print sum + 0 }'; }

for condition in "${chosen[@]}"; do setting "$condition" >/dev/null || [ $? = 1 ] || exit 2; done
mkdir -p "$OUT"
status=0
printf '%-14s %8s %8s %8s\n' condition seconds passed failed
for condition in "${chosen[@]}"; do
	if ! words=$(setting "$condition"); then
		printf '%-14s %s\n' "$condition" "skipped: not this processor's"
		continue
	fi
	if [ "$condition" = busy ]; then
		for _ in 1 2; do
			while :; do :; done &
			loops+=($!)
		done
	fi
	log=$OUT/$condition.log began=$SECONDS ended=0
	# shellcheck disable=SC2086  # words are words
	env OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 LP_NUM_THREADS=1 $words \
		"$PY" -m pytest "$@" >"$log" 2>&1 || ended=$?
	end_loops
	last=$(tail -n 1 "$log")
	failed=$(($(counted failed "$last") + $(counted 'errors?' "$last")))
	if [ "$ended" != 0 ]; then
		status=1
		[ "$failed" != 0 ] || failed="exit $ended"
	fi
	printf '%-14s %8s %8s %8s\n' "$condition" $((SECONDS - began)) "$(counted passed "$last")" "$failed"
done
exit "$status"
