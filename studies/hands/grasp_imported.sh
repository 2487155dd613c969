#!/usr/bin/env bash
# Grasps by hands as their files have them, with no step in between; writes a line of CSV for each hand and object.
#   studies/hands/grasp_imported.sh OUT.csv OBJECT[,OBJECT...] HAND_FILE... ; RUN="taskset -c 0" goes before each command
# imported.csv: the right hands' vendor files with can,box,ball; then, with can alone, allegro_left_hand.urdf of the
# package example-robot-data 6.0.0 and `xdex hand mirror shadow --out shadow_left.yaml`. Two cores, other work beside it.
set -u
table=$1 objects=${2//,/ }
shift 2
folder=$(mktemp -d)
trap 'rm -r "$folder"' EXIT
[ -s "$table" ] || echo "hand,object,tried,certified,lifted,seconds,says" > "$table"
for hand in "$@"; do
  for object in $objects; do
    ${RUN:-} xdex grasp --hand "$hand" --object "$object" --count 2 --workers 1 --seed 0 --time-limit 120 --keep-failed \
      --out "$folder/grasps.parquet" > "$folder/log" 2> "$folder/errors"
    value() { sed -nE "s/^$1  +([^ ]+).*/\1/p" "$folder/log" | head -1; }
    says=""
    [ -n "$(value tried)" ] || says=$(cat "$folder/log" "$folder/errors" | tail -1 | tr ',"' ';_')
    name=$(basename "$hand"); name=${name%.*}
    echo "$name,$object,$(value tried),$(value certified),$(value lifted),$(value seconds),\"$says\"" >> "$table"
  done
done
