"""Mission folders: CSV files of a vehicle's track, its sonar contacts and the truth; `nls.missions` has the names."""
