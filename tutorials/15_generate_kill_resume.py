# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Generate, kill, resume
#
# A paired data set takes hours, and in hours machines go away. This tutorial starts one, kills it without warning, goes
# on, checks that nothing was lost, and reads the result with other tools. It needs the library alone, runs in about a
# minute, and writes the folder `pairs`.

# %%
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
from PIL import Image

import xdex_drake as xd
from xdex_drake.visualization.pictures import contact_sheet

# %% [markdown]
# ## What is to be made
#
# A configuration is a few lines of YAML; `xdex dataset generate --print-config` prints all keys with their defaults.
# Hands and objects are names, files, or ranges of generated ones (`g0-0000..g0-0999`). From it follows the plan: units
# of one source hand on one scene. A unit depends on the configuration and its own number alone, and so it does not
# matter who makes it, or when.

# %%
Path("pairs.yaml").write_text("""\
hands: [inspire, ability]
source_hands: [inspire]
objects: [can, ball, box]
candidates: 16
sources_per_unit: 2
hold_every: 2
""")
GENERATE = [sys.executable, "-m", "xdex_drake", "dataset", "generate", "pairs.yaml", "--out", "pairs", "--workers", "1"]

# %% [markdown]
# ## Kill
#
# We wait for the first shard, and then send SIGKILL, which no program can catch: this is what a power cut looks like.
# The folder's lock goes with the process, and so do its workers.

# %%
shards, begin = Path("pairs/shards"), time.monotonic()
run = subprocess.Popen(GENERATE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
while run.poll() is None and not list(shards.glob("[!.]*.parquet")) and time.monotonic() - begin < 240.0:
    time.sleep(0.05)
run.send_signal(signal.SIGKILL)
run.wait()
planned = json.loads(Path("pairs/manifest.json").read_text())["units"]
before = {path.name: path.read_bytes() for path in shards.glob("[!.]*.parquet")}
print(f"killed with {len(before)} of {len(planned)} units done: {', '.join(before)}")

# %% [markdown]
# A shard is written under a hidden name, synced, and takes its own name only then: it is there as a whole or not at
# all. The set of shards is all the state there is, so that nothing else can be out of step with it.
#
# ## Resume
#
# The same command goes on. It would refuse another configuration, and a second run at the same time.

# %%
done = subprocess.run(GENERATE, capture_output=True, text=True, check=True)
print(done.stdout)
after = {path.name: path.read_bytes() for path in shards.glob("[!.]*.parquet")}
assert all(after[name] == data for name, data in before.items()) and len(after) == len(planned)

# %% [markdown]
# What was there was not touched. `verify` reads every shard to its last byte and checks every certificate again, in
# plain NumPy: a damaged shard would be named here, and made again by the next run.

# %%
subprocess.run([sys.executable, "-m", "xdex_drake", "dataset", "verify", "pairs"], check=True)

# %% [markdown]
# ## Read
#
# Shards are Parquet, one row a grasp, and the unit and meaning of every column stand in them. Any tool reads the folder
# in a line; of these, pyarrow comes with the library:
#
# ```python
# duckdb.sql("SELECT hand, count(*), avg(success::int) FROM 'pairs/shards/*.parquet' GROUP BY hand")
# datasets.load_dataset("parquet", data_files="pairs/shards/*.parquet")  # of Hugging Face
# ```

# %%
table = pq.read_table("pairs/shards")
rows = table.select(["hand", "object", "source_grasp_id", "success", "failure_reason"]).to_pylist()
for hand in sorted({row["hand"] for row in rows}):
    mine = [row for row in rows if row["hand"] == hand]
    print(f"{hand}: {len(mine)} grasps, {sum(row['success'] for row in mine)} lifted")
print("meaning of q_squeeze:", table.schema.field("q_squeeze").metadata[b"meaning"].decode())
if xd.can_see():
    stored = xd.load_grasps(min(shards.glob("[!.]*.parquet")))[:4]
    pictures = [xd.render_grasp(one.grasp, one.hand, one.scene) for one in stored]
    Image.fromarray(contact_sheet(pictures, [f"{one.hand.name}, {one.row['object']}" for one in stored])).save(
        "pairs.png"
    )

# %% [markdown]
# ## Send, and spread
#
# The folder can be sent as it is: hands and meshes that came from files lie in `pairs/assets`, with the licences that
# lay beside them, and are found by their digests. `xdex dataset card pairs` writes a `README.md` with counts, rates,
# licences and pictures. A large set fits into small files that a repository takes: `xdex dataset compact pairs --out
# table`.
#
# On more machines, each makes a part, on one folder or on several whose shards are put together afterwards; or a Ray
# cluster makes all of it, and may lose machines on the way. The rows are the same.
#
# ```sh
# xdex dataset generate pairs.yaml --out pairs --shard 2/8     # the second of eight parts
# xdex dataset generate pairs.yaml --out pairs --ray auto      # needs pip install 'xdex_drake[ray]'
# ```
#
# **Exercise.** Cut the last bytes off a shard (`path.write_bytes(path.read_bytes()[:-40])`). What does `verify` say,
# and what does the next run do? Are the bytes of the shard that it makes those of the one that you damaged?
