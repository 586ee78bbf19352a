# Every task with a tiny network on a CPU, some minutes in all: sh benchmarks/reconstruction/plans/smoke.sh
set -e
TRAIN="python -m benchmarks.reconstruction.train --smoke --device cpu --data runs/smoke/garments"
$TRAIN --model panel_set --task T0 --out runs/smoke/T0-panel_set
$TRAIN --model edge_tokens --task T0 --out runs/smoke/T0-edge_tokens
$TRAIN --model parameters --task T0 --out runs/smoke/T0-parameters
$TRAIN --model nearest --task T0 --out runs/smoke/T0-nearest
$TRAIN --model typical --task T0 --out runs/smoke/T0-typical
$TRAIN --model ceiling --task T0 --out runs/smoke/T0-ceiling
$TRAIN --model benchmarks/examples/tiny_model.py:build --task T0 --out runs/smoke/T0-tiny_model
$TRAIN --model panel_set --task T1 --out runs/smoke/T1-panel_set
$TRAIN --model panel_set --task T1-scan --out runs/smoke/T1-scan-panel_set
$TRAIN --model picture_parameters --task T2 --out runs/smoke/T2-picture_parameters
$TRAIN --model typical --task T2 --out runs/smoke/T2-typical
$TRAIN --model stitches --task T3 --out runs/smoke/T3-stitches
$TRAIN --model segmentation --task T4 --out runs/smoke/T4-segmentation
$TRAIN --model nearest_labels --task T4 --out runs/smoke/T4-nearest_labels
$TRAIN --model measures --task T5 --out runs/smoke/T5-measures
$TRAIN --model mean_measures --task T5 --out runs/smoke/T5-mean_measures
$TRAIN --model nearest_measures --task T5 --out runs/smoke/T5-nearest_measures
$TRAIN --model drape_surrogate --task T6 --out runs/smoke/T6-drape_surrogate
$TRAIN --model box_mesh --task T6 --out runs/smoke/T6-box_mesh
$TRAIN --model coarse_drape --task T6 --out runs/smoke/T6-coarse_drape
$TRAIN --model solver --task T6 --out runs/smoke/T6-solver
$TRAIN --model fit --task T7 --out runs/smoke/T7-fit
$TRAIN --model mean_measures --task T7 --out runs/smoke/T7-mean_measures
$TRAIN --model nearest_fit --task T7 --out runs/smoke/T7-nearest_fit
$TRAIN --model motion_residual --task T8 --out runs/smoke/T8-motion_residual
$TRAIN --model frozen --task T8 --train 6 --test 4 --resolution 6 --out runs/smoke/T8-frozen
$TRAIN --model skinned --task T8 --train 6 --test 4 --resolution 6 --out runs/smoke/T8-skinned
$TRAIN --model panel_set --task T1 --test-source T1-scan --out runs/smoke/T1-panel_set
mkdir -p runs/freesewing && tar -xJf benchmarks/data/freesewing.tar.xz -C runs/freesewing
$TRAIN --model stitches --task T3 --test-source runs/freesewing --out runs/smoke/T3-stitches
