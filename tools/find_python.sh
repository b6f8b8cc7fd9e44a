#!/bin/sh
# Print the first usable Python: one of the versions given (such as 3.11 3.12), with venv and ensurepip.
# Usage: find_python.sh VERSION...
for version in "$@"; do
  for candidate in "python$version" /usr/local/bin/python"$version" "$HOME"/.pyenv/versions/"$version"*/bin/python \
    /opt/python/"$version"*/bin/python python3 python; do
    if "$candidate" -c "import sys, venv, ensurepip; sys.exit('%d.%d' % sys.version_info[:2] != '$version')" \
      >/dev/null 2>&1; then
      command -v "$candidate"
      exit 0
    fi
  done
done
echo "facewright needs Python $(echo "$@" | sed 's/ / or /g') with its venv module (on Debian: apt-get install python3-venv);" \
  "name one with PYTHON=/path/to/python." >&2
exit 1
