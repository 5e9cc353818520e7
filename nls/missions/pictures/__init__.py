"""Pictures of missions, sonars, scans and rigs; `nls.plot` has the names of those that pages use most."""
