"""`lpvguard campaign`: Monte Carlo over the closed loop of the simulated truck, which scores the monitor and
the baselines.

    faults.py      the kinds of faults and variations, at several severities
    scenarios.py   the plan: every run's number, truck, fault, speed and command, drawn from the seed
    conduct.py     the loop's conduct in a run, and its contradictions of the certificate
    trucks.py      which trucks lie within the bounds by their own frequency response; mu of faulted loops
    one_run.py     one run: simulated, replayed through the core, judged by every detector and off line
    summary.py     the tables from the rows of the runs, and the claims that the campaign contradicts
    chunked_runs.py  the campaign: it stores finished runs and can be resumed

A campaign has two groups of runs of DURATION_S each. Every run is a scenario of its own, drawn from the
campaign's seed and the number of the run:

    within   trucks that vary in load, CG, tyres, brakes and friction, and whose own frequency response lies
             within the bounds at every frequency; any alarm is false, and a run that oscillates, saturates or
             loses track falsifies the certificate. Speeds and demands lie in the checked ranges
    faults   KINDS: one fault or variation, of the truck, of the bus, or of both at once, at several
             severities

Two scores are kept apart. The detectors of model error are scored on faults of the truck, alone or with one
of the bus. The supervision is scored on faults of the bus, alone or with one of the truck. The frames on the
bus and the message table determine its required state at every tick (supervision.py). Alarms of detectors
under a fault of the bus alone are counted and not scored. A corrupted or late value that passes for a good
one is a model error for any detector that sees only the values.

Files in the campaign's folder (each whole or absent):

    MANIFEST.json      seed, sizes, inputs; another campaign is refused; and the seal of the files so far
    baselines.json     parameters and thresholds of the baselines (evaluate.BaselineStudy, all calibration
                       drives)
    plants.json        candidates for "within" with their |delta|/W_delta, and that of the faulted trucks
    loops.json         mu of the faulted loops, where a controller was given
    chunks/NNNNN.parquet   rows of CHUNK runs
    runs.parquet       all rows
    summary.json       the tables
"""
