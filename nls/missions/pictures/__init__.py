"""Pictures of missions, sonars and scans; `nls.plot` has the names of those that pages use most."""
