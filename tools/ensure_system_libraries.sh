#!/bin/sh
# OpenCV (MediaPipe's) and Open3D load libGL, libX11, glib and others of the system: install them where that is possible,
# else say how. Usage: ensure_system_libraries.sh PYTHON MODULE...
python=$1
shift
modules=$(echo "$@" | sed 's/ /, /g')
packages="libgl1 libegl1 libgles2 libglib2.0-0 libx11-6 libudev1 libgomp1"
loads() { "$python" -c "import $modules" >/dev/null 2>&1; }
loads && exit 0
reason=$("$python" -c "import $modules" 2>&1 | tail -n 1)
case $reason in
  *.so*) ;;
  *) echo "One of $modules does not load: $reason" >&2; exit 1 ;;
esac
echo "A system library is missing ($reason)."
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  echo "Installing $packages with apt-get ..."
  apt-get update -qq </dev/null >/dev/null
  # shellcheck disable=SC2086  # one word a package
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $packages </dev/null >/dev/null
fi
loads && exit 0
echo "Please install the system libraries libGL, libEGL, libGLESv2, glib, libX11, libudev and libgomp:" >&2
echo "  Debian, Ubuntu:  sudo apt-get install $packages" >&2
echo "  Fedora:          sudo dnf install mesa-libGL mesa-libEGL mesa-libGLES glib2 libX11 systemd-libs libgomp" >&2
exit 1
