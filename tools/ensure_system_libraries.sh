#!/bin/sh
# MediaPipe's OpenCV loads libGL and glib of the system: install them where that is possible, else say how.
# Usage: ensure_system_libraries.sh PYTHON
python=$1
loads() { "$python" -c "import cv2, mediapipe" >/dev/null 2>&1; }
loads && exit 0
reason=$("$python" -c "import cv2, mediapipe" 2>&1 | tail -n 1)
case $reason in
  *.so*) ;;
  *) echo "OpenCV does not load: $reason" >&2; exit 1 ;;
esac
echo "OpenCV needs a system library ($reason)."
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  echo "Installing libgl1, libegl1, libgles2 and libglib2.0-0 with apt-get ..."
  apt-get update -qq </dev/null >/dev/null
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
    libgl1 libegl1 libgles2 libglib2.0-0 </dev/null >/dev/null
fi
loads && exit 0
echo "Please install the system libraries libGL, libEGL, libGLESv2 and glib:" >&2
echo "  Debian, Ubuntu:  sudo apt-get install libgl1 libegl1 libgles2 libglib2.0-0" >&2
echo "  Fedora:          sudo dnf install mesa-libGL mesa-libEGL mesa-libGLES glib2" >&2
exit 1
