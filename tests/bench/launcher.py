"""Runs a command and prints what it used: `launcher.py LOG COMMAND ...`.

Linux counts the memory of the process that starts a command as peak of that command, too (`ru_maxrss` outlives `exec`).
So commands are started by this small process, not by the bench, which grows.
"""

import json
import os
import sys

log, *command = sys.argv[1:]
stdout = (os.POSIX_SPAWN_OPEN, 1, log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
process = os.posix_spawnp(command[0], command, os.environ, file_actions=[stdout, (os.POSIX_SPAWN_DUP2, 1, 2)])
_, status, usage = os.wait4(process, 0)
peak_bytes = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
print(json.dumps([os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, peak_bytes]))
