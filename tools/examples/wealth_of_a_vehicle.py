"""The wealth of two vehicles over their lives: one stays healthy, one wears.

python wealth_of_a_vehicle.py PICTURE.svg
"""

import sys

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

from lpvguard.extras.fleet.wealth import Life, LifeTable

matplotlib.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "lpvguard"})
draw = np.random.default_rng(1)
table = LifeTable.from_scores(draw.normal(0.5, 0.1, 100), alpha=0.05, eta=0.05)
figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
for name, wear in (("healthy", 0.0), ("wears from recording 40 on", 0.01)):
    life, wealth = Life(), [1.0]
    for recording in range(80):
        score = draw.normal(0.5 + wear * max(recording - 40, 0), 0.1)
        life = life.after(int(table.place(score)), table)
        wealth.append(life.wealth)
    print(f"{name}: {f'alarm with recording {life.changed_at}' if life.changed_at else 'no alarm'}")
    axes.semilogy(wealth, label=name)
axes.axhline(table.alarm, color="k", linestyle="--", label="alarm, 1/alpha")
axes.set(xlabel="recording", ylabel="wealth", ylim=(0.1, 1e4))
axes.legend()
figure.savefig(sys.argv[1], metadata={"Date": None})
