#!/bin/sh
# The tests of the pages drive a real Chromium: find one, else install one where that is possible, else say that they
# will be skipped. Never fails. Usage: ensure_browser.sh PYTHON
python=$1
found() {
  for name in chromium chromium-browser google-chrome google-chrome-stable; do
    command -v "$name" >/dev/null 2>&1 && return 0
  done
  "$python" - <<'CODE' >/dev/null 2>&1
from pathlib import Path
from playwright.sync_api import sync_playwright
with sync_playwright() as p:
    raise SystemExit(0 if Path(p.chromium.executable_path).exists() else 1)
CODE
}
found && exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  echo "Installing chromium with apt-get for the tests of the pages ..."
  apt-get update -qq </dev/null >/dev/null 2>&1
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium </dev/null >/dev/null 2>&1
  found && exit 0
fi
echo "Installing Playwright's Chromium for the tests of the pages ..."
timeout 300 "$python" -m playwright install chromium </dev/null >/dev/null 2>&1
found && exit 0
echo "No Chromium was found or could be installed: the tests of the pages will be skipped."
exit 0
