"""The nodes: thin shells around the core, one module each."""

from mobo_tuner.interrupts import end_quietly

end_quietly(("console", "live_server", "machine_bridge", "page", "recorder", "steer", "tuner"))
