#!/usr/bin/env bash
# Build wheel and sdist, check them, install the wheel into an empty venv and run its demo; install
# from the repository as docs/start.md says.
# Usage: tests/wheel.sh PYTHON
set -euo pipefail
python=$(realpath -s "$1")
cd "$(dirname "$0")/.."
source=$PWD
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

mkdir "$work/source"  # a copy: a build leaves its own folders behind
tar --exclude=./.venv --exclude=./.git --exclude=./runs --exclude=./build -cf - . | tar -xf - -C "$work/source"
"$python" -m build --outdir "$work/dist" "$work/source" >"$work/build.log" 2>&1 || { tail -20 "$work/build.log" >&2; exit 1; }
"$python" -m twine check --strict "$work"/dist/*
"$python" -m venv "$work/venv"
wheel=$(echo "$work"/dist/*.whl)
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-input "$wheel[astro]"
cd "$work"  # nothing of the source tree is at hand
timeout 1200 "$work/venv/bin/bsp-gp" demo --quiet --out demo | tail -n 1
test -s demo/report.html
"$work/venv/bin/bsp-gp" grammar list >grammars.txt
grep -q '^physics:' grammars.txt

# The blocks of two pages that install, as a newcomer types them.
block() { sed -n '/tests\/wheel.sh does -->$/,/^```$/p' "$source/docs/$1" | sed '/^```\|^<!--/d'; }
mkdir newcomer && cd newcomer
block start.md | sed "s#/path/to/this/repository#$work/source#; s#pip install#& --quiet#" >start.sh
(
    PATH="$(dirname "$("$python" -c 'import sys; print(sys._base_executable)')"):$PATH"
    . ./start.sh
    test "$(command -v bsp-gp)" = "$PWD/.venv/bin/bsp-gp"
    bsp-gp check "$source/examples/falls.csv" >seen.txt
    (cd "$source" && "$python" -m tests.snippets docs/grammars.md "$work/newcomer/page") >/dev/null
    cd page
    block grammars.md >flow.sh
    . ./flow.sh
)
echo "Wheel and sdist are sound."
