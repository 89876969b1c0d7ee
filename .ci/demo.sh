#!/bin/sh
# Play, train a policy, give it eyes, evaluate: the whole line on this machine's cores. A stage that is done is not done again.
set -eu
cd "$(dirname "$0")/.."
demo=${1:-runs/demo}
playlearn() { .venv/bin/python -m playlearn.cli "$@"; }

stage() {
	name=$1
	shift
	printf '\n== %s\n' "$name"
	begin=$(date +%s)
	"$@"
	end=$(date +%s)
	times="$times$(printf '%-28s %5d s' "$name" $((end - begin)))
"
}

evaluate() {
	# Results older than the last checkpoint speak of another policy.
	if [ "$demo/eval/results.json" -nt "$demo/run/checkpoint/last.safetensors" ]; then
		echo "already evaluated: $demo/eval"
		return
	fi
	playlearn eval --run "$demo/run" --suite eval/suites/playtable_tasks.yaml --goal image --out "$demo/eval"
}

train() {
	run=$1
	shift
	resume=
	[ -f "$run/config.yaml" ] && resume=--resume
	playlearn train --store "$demo/play" --out "$run" "$@" $resume
}

times=
stage "collect play" playlearn collect --config configs/collect/demo.yaml --out "$demo/play" --resume
stage "learn what to do" train "$demo/state" --config configs/train/playtable_state_diffusion.yaml --max_minutes 3
stage "learn to see" train "$demo/run" --config configs/train/playtable_image.yaml --init "$demo/state" --max_minutes 9
stage "reach goal images" evaluate
printf '\n%s\nThe report: %s\n' "$times" "$demo/eval/report.html"
