#!/usr/bin/env bash
# Ten lifted grasps on each of ten scanned and modelled meshes, by each of three hands.
#   studies/meshes/run.sh MESH_FOLDER OUT_FOLDER > log.txt && python studies/meshes/summarize.py log.txt OUT_FOLDER
set -u
meshes=$1 out=$2
mkdir -p "$out"
for hand in allegro shadow ability; do
  for object in ycb_015_peach robosuite_milk robosuite_bottle pybullet_mug robosuite_cereal drake_bell_pepper \
      prl_fuze_bottle ycb_065_d_cups gso_android_toy egad_train_D04_1; do
    echo "=== $hand $object"
    xdex grasp --hand "$hand" --object "$meshes/$object.obj" --count 10 --keep-failed \
      --out "$out/$hand-$object.parquet" --time-limit 120 2>/dev/null
  done
done
