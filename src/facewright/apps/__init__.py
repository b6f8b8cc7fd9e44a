"""One function per user story: typed request in, typed result out, progress by callback."""
