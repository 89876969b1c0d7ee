#!/bin/sh
# Bring the environment in .venv to what requirements.lock says. Needs a Python of any kind (3.9 or newer) and nothing
# else: uv comes by pip into .setup/, and finds or fetches Python 3.12. Writes nothing outside this folder but caches.
#
#   setup.sh             set up; a machine that cannot draw images is told how to mend that
#   setup.sh --need-gl   the same, and fail where images cannot be drawn
#   setup.sh --lock      write requirements.lock again from pyproject.toml
set -eu
cd "$(dirname "$0")/.."
unset VIRTUAL_ENV PYTHONPATH PYTHONHOME

say() { printf 'setup: %s\n' "$*" >&2; }
die() { say "$@"; exit 1; }

may_install() { [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; }

apt_install() {
	apt-get update -q >&2 && DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "$@" >&2
}

# A Python that runs. In this folder pyenv may insist on a 3.12 that it does not have, so ask from / as well.
some_python() {
	for candidate in ${PYTHON:-} python3 python /usr/bin/python3 /usr/local/bin/python3; do
		for place in . /; do
			(cd "$place" && "$candidate" -c 'import sys; sys.version_info >= (3, 9) or sys.exit(1); print(sys.executable)') \
				2>/dev/null && return
		done
	done
	return 1
}

bring_uv() {
	UV=.setup/bin/uv
	if "$UV" --version >/dev/null 2>&1; then return; fi
	python=$(some_python) || die "no Python 3.9 or newer is here; install one (Debian: apt-get install python3) and try again"
	say "bringing uv into .setup/"
	rm -rf .setup
	by_venv "$python" || by_target "$python" || {
		may_install && apt_install python3-venv && rm -rf .setup && by_venv /usr/bin/python3
	} || by_path || die "$python has neither venv nor pip; run \`apt-get install python3-venv\` as root, or install uv, and try again"
}
by_venv() { "$1" -m venv .setup >/dev/null 2>&1 && .setup/bin/python -m pip install -q uv; }
by_target() {
	rm -rf .setup
	"$1" -m pip install -q --target .setup/uv uv 2>/dev/null && mkdir -p .setup/bin && ln -sf ../uv/bin/uv "$UV" && "$UV" --version >/dev/null
}
by_path() { UV=$(command -v uv) && "$UV" --version >/dev/null 2>&1; }

# What the environment was made from: another lock, another version of the project or a moved folder makes it stale.
key() { { cat requirements.lock pyproject.toml .python-version; pwd; } | cksum; }

install() {
	[ "$(cat .venv/.stamp 2>/dev/null)" = "$(key)" ] && return
	bring_uv
	# An interrupted install may have left half a package, and scripts know the folder they were made in: begin afresh;
	# uv's cache has what was fetched.
	if [ -f .venv/.unfinished ] || [ "$(cat .venv/.place 2>/dev/null)" != "$(pwd)" ] || ! .venv/bin/python --version >/dev/null 2>&1; then
		"$UV" venv -q --clear --python "$(cat .python-version)" .venv || die "Python $(cat .python-version) is neither here nor" \
			"could it be fetched; install it (\`pyenv install 3.12\`, or your system's python3.12) and try again"
	fi
	say "installing the packages of requirements.lock into .venv/ (7 GB; the first time takes minutes)"
	touch .venv/.unfinished
	pwd >.venv/.place
	"$UV" pip sync -q --python .venv/bin/python --require-hashes requirements.lock ||
		die "not everything could be installed; check the network and the room on the disk, and try again"
	rm .venv/.unfinished
	"$UV" pip install -q --python .venv/bin/python --no-deps --no-build-isolation -e .
	# robosuite's source has escapes that Python warns of whenever it compiles them, so once, here and quietly.
	.venv/bin/python -W ignore -m compileall -q "$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/robosuite" || true
	# Where Python is told to keep no bytecode, as in many containers, each process would compile torch and the rest anew.
	PYTHONDONTWRITEBYTECODE='' .venv/bin/python -W ignore -c 'import diffusers, playlearn.demo, torchvision, transformers' >/dev/null 2>&1 || true
	key >.venv/.stamp
}

# Drawing needs a system library that no package on PyPI ships; the doctor draws, or prints the command that mends it.
gl() {
	[ -f .venv/.gl ] && return
	if ! command=$(.venv/bin/python -m playlearn.doctor); then
		if may_install; then
			say "installing headless GL: $command"
			sh -c "$command" >&2 || say "that failed"
		fi
		.venv/bin/python -m playlearn.doctor >/dev/null || {
			say "images cannot be drawn here: there is no headless GL. As root: $command"
			return 1
		}
	fi
	touch .venv/.gl
}

lock() {
	bring_uv
	"$UV" pip compile -q pyproject.toml --group dev --universal --python-version "$(cat .python-version)" --generate-hashes \
		--no-header --no-emit-index-url --no-emit-find-links -o requirements.lock
	say "wrote requirements.lock"
}

case "${1:-}" in
--lock) lock ;;
--need-gl) install; gl ;;
"") install; gl || true ;;
*) die "unknown argument $1" ;;
esac
