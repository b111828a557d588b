#!/usr/bin/env bash
# Creates .venv beside this script and installs the lab into it. Run it again after any change of pyproject.toml.
set -euo pipefail

lab="$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")" && pwd)"
python="${PYTHON:-python3.11}"

if ! "$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null; then
    echo "setup.sh: '$python' is not Python 3.11; install it, or name one: PYTHON=/path/to/python3.11 $0" >&2
    exit 1
fi
if [ ! -x "$lab/.venv/bin/python" ]; then
    "$python" -m venv "$lab/.venv"
fi
"$lab/.venv/bin/python" -m pip install --disable-pip-version-check --editable "$lab[test]"
echo "ready: \"$lab/.venv/bin/python\" -m rigidformer_lab.movi --help"
