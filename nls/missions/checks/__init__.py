"""Are the tables of a mission plausible? Checks of its numbers, each with the unit, sign or frame that explains it.

Is a clock off, and where does a sensor sit? Every kind of evidence has one function. Before a solution, spans of tables
and fixes under water show a clock (`agreement.clocks_by_spans`), and so does the way down by DVL and depth
(`agreement.of_way_down`). At the optimum an error of a whole table is a clock or an arm (`table_errors`); a solution
with it as a variable proves it (`trials.explained`). Scans show both of their sensor (`scan_setup.mounting`). Graphs
without tables have `nls.analysis.clock` and `nls.analysis.calibrations`.
"""
