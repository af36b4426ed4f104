"""Exit statuses."""

FINE, NOTHING_HOLDS, BAD_INPUT, INTERRUPTED, UNREAD = 0, 1, 2, 130, 141
FAULT = 70  # EX_SOFTWARE in BSD's sysexits.h; an uncaught exception's 1 means NOTHING_HOLDS here.
