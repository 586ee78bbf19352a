# Every run of docs/reconstruction.md, a line each: any line may be run alone, on any GPU (CUDA_VISIBLE_DEVICES=1 before it).
# Garments are made by the first run that needs them (--make-only), and lie in runs/garments. A killed run goes on
# where it stopped when its line is repeated. Fresh garments are drapes of a second GPU, cuda:1.
# mkdir -p runs/freesewing && tar -xJf benchmarks/data/freesewing.tar.xz -C runs/freesewing
TRAIN="python -m benchmarks.reconstruction.train"

$TRAIN --model edge_tokens --task T0 --train 24000 --minutes 2 --checks 1 --drape --out runs/T0-edge_tokens
$TRAIN --model panel_set --task T0 --train 24000 --minutes 2 --checks 1 --drape --out runs/T0-panel_set
$TRAIN --model parameters --task T0 --train 1000 --minutes 2 --checks 1 --compile --drape --out runs/T0-sizes-1000
$TRAIN --model parameters --task T0 --train 24000 --minutes 2 --checks 1 --compile --drape --out runs/T0-sizes-24000
$TRAIN --model parameters --task T0 --train 4000 --minutes 2 --checks 1 --compile --drape --out runs/T0-sizes-4000
$TRAIN --model parameters --task T0 --train 4000 --steps 800 --checks 1 --compile --out runs/families-T0-all
$TRAIN --model parameters --task T0 --train 4000 --leave-out dress --steps 800 --checks 1 --compile --out runs/families-T0-dress
$TRAIN --model parameters --task T0 --train 4000 --leave-out jumpsuit --steps 800 --checks 1 --compile --out runs/families-T0-jumpsuit
$TRAIN --model parameters --task T0 --train 4000 --leave-out pants --steps 800 --checks 1 --compile --out runs/families-T0-pants
$TRAIN --model parameters --task T0 --train 4000 --leave-out skirt --steps 800 --checks 1 --compile --out runs/families-T0-skirt
$TRAIN --model parameters --task T0 --train 4000 --leave-out upper_garment --steps 800 --checks 1 --compile --out runs/families-T0-upper_garment

$TRAIN --model ceiling --task T1 --train 16000 --drape --out runs/T1-ceiling
$TRAIN --model edge_tokens --task T1 --train 16000 --minutes 2 --drape --checks 1 --out runs/T1-16k-edge_tokens
$TRAIN --model edge_tokens --task T1 --train 40000 --minutes 7 --checks 1 --compile --drape --out runs/T1-tokens
$TRAIN --model nearest --task T1 --train 16000 --drape --out runs/T1-16k-nearest
$TRAIN --model nearest --task T1 --train 40000 --drape --out runs/T1-nearest
$TRAIN --model panel_set --task T1 --train 16000 --minutes 2 --drape --checks 1 --out runs/T1-16k-panel_set
$TRAIN --model panel_set --task T1 --train 40000 --minutes 7 --checks 1 --compile --drape --out runs/T1-panels
$TRAIN --model parameters --task T1 --train 1000 --minutes 3 --checks 1 --compile --drape --out runs/T1-sizes-1000
$TRAIN --model parameters --task T1 --train 16000 --minutes 2 --checks 1 --drape --out runs/T1-sixteen-parameters
$TRAIN --model parameters --task T1 --train 4000 --minutes 3 --checks 1 --compile --drape --out runs/T1-sizes-4000
$TRAIN --model parameters --task T1 --train 4000 --steps 800 --checks 1 --compile --out runs/families-T1-all
$TRAIN --model parameters --task T1 --train 4000 --fresh 65536 --minutes 3 --checks 1 --workers 15 --compile --make-device cuda:1 --drape --out runs/T1-fresh
$TRAIN --model parameters --task T1 --train 4000 --leave-out dress --steps 800 --checks 1 --compile --out runs/families-T1-dress
$TRAIN --model parameters --task T1 --train 4000 --leave-out jumpsuit --steps 800 --checks 1 --compile --out runs/families-T1-jumpsuit
$TRAIN --model parameters --task T1 --train 4000 --leave-out pants --steps 800 --checks 1 --compile --out runs/families-T1-pants
$TRAIN --model parameters --task T1 --train 4000 --leave-out skirt --steps 800 --checks 1 --compile --out runs/families-T1-skirt
$TRAIN --model parameters --task T1 --train 4000 --leave-out upper_garment --steps 800 --checks 1 --compile --out runs/families-T1-upper_garment
$TRAIN --model parameters --task T1 --set augmented=1 --train 40000 --minutes 7 --checks 1 --compile --drape --out runs/T1-long
$TRAIN --model parameters --task T1 --set augmented=1 labelled=1 --train 40000 --minutes 7 --checks 1 --compile --drape --out runs/T1-labels
$TRAIN --model parameters --task T1 --set augmented=1 labelled=1 seen=0 --train 40000 --minutes 7 --checks 1 --compile --drape --out runs/T1-labels_regions
$TRAIN --model parameters --task T1 --set augmented=1 labelled=1 seen=0 points=8192 --train 40000 --minutes 7 --checks 1 --compile --drape --out runs/T1-labels_regions_points
$TRAIN --model parameters --task T1 --train 40000 --set width=240 heads=6 layers=4 augmented=1 labelled=1 seen=0 --compile --minutes 6.5 --checks 2 --validate 500 --out runs/T1-40k-seed0
$TRAIN --model parameters --task T1 --train 40000 --set width=240 heads=6 layers=4 augmented=1 labelled=1 seen=0 --compile --minutes 6.5 --checks 2 --validate 500 --seed 1 --out runs/T1-40k-seed1
$TRAIN --model parameters --task T1 --train 40000 --set width=240 heads=6 layers=4 augmented=1 labelled=1 seen=0 --compile --minutes 6.5 --checks 2 --validate 500 --seed 2 --out runs/T1-40k-seed2
$TRAIN --model parameters --task T1 --train 76150 --set width=240 heads=6 layers=4 augmented=1 labelled=1 seen=0 --compile --minutes 6.5 --checks 1 --validate 500 --out runs/T1-76k-seed0
$TRAIN --model parameters --task T1 --train 76150 --set width=240 heads=6 layers=4 augmented=1 labelled=1 seen=0 --compile --minutes 6.5 --checks 1 --validate 500 --seed 1 --out runs/T1-76k-seed1
$TRAIN --model parameters --task T1 --train 56158 --train-seed 7 --set width=240 heads=6 layers=4 augmented=1 labelled=1 seen=0 --weights runs/T1-76k-seed0/weights.pt --lr 3e-4 --compile --minutes 5.8 --checks 3 --validate 500 --out runs/T1-56k-on
$TRAIN --model parameters --task T1 --train 64 --set width=240 heads=6 layers=4 augmented=1 labelled=1 seen=0 --steps 0 --weights runs/T1-76k-seed0/weights.pt,runs/T1-56k-on/weights.pt --validate 500 --out runs/T1-mean

$TRAIN --model nearest --task T1-scan --train 4000 --drape --out runs/scan-reference
$TRAIN --model parameters --task T1-scan --train 4000 --minutes 2 --checks 1 --compile --drape --out runs/scan
$TRAIN --model parameters --task T1-scan --set width=256 heads=4 layers=4 augmented=1 seen=0 --train 12000 --minutes 6 --checks 2 --validate 500 --compile --out runs/scan-12k
$TRAIN --model parameters --task T1-scan --train 20000 --set width=240 heads=6 layers=4 augmented=1 labelled=1 seen=0 --weights runs/T1-76k-seed0/weights.pt --lr 3e-4 --minutes 6 --checks 1 --validate 500 --compile --out runs/scan-20k

$TRAIN --model picture_parameters --task T2 --train 4000 --steps 700 --checks 1 --compile --out runs/families-T2-all
$TRAIN --model picture_parameters --task T2 --train 4000 --leave-out dress --steps 700 --checks 1 --compile --out runs/families-T2-dress
$TRAIN --model picture_parameters --task T2 --train 4000 --leave-out jumpsuit --steps 700 --checks 1 --compile --out runs/families-T2-jumpsuit
$TRAIN --model picture_parameters --task T2 --train 4000 --leave-out pants --steps 700 --checks 1 --compile --out runs/families-T2-pants
$TRAIN --model picture_parameters --task T2 --train 4000 --leave-out skirt --steps 700 --checks 1 --compile --out runs/families-T2-skirt
$TRAIN --model picture_parameters --task T2 --train 4000 --leave-out upper_garment --steps 700 --checks 1 --compile --out runs/families-T2-upper_garment
$TRAIN --model picture_parameters --task T2 --set augmented=1 --train 1000 --minutes 2 --checks 1 --compile --drape --out runs/T2-sizes-1000
$TRAIN --model picture_parameters --task T2 --set augmented=1 --train 4000 --minutes 2 --checks 1 --compile --drape --out runs/T2-sizes-4000
$TRAIN --model picture_parameters --task T2 --set augmented=1 --train 4000 --fresh 20000 --minutes 2 --checks 1 --workers 15 --compile --make-device cuda:1 --drape --out runs/T2-fresh
$TRAIN --model picture_parameters --task T2 --set augmented=1 --train 8000 --fresh 24000 --minutes 7 --checks 1 --workers 40 --compile --make-device cuda:1 --drape --out runs/T2-long
$TRAIN --model picture_parameters --task T2 --set views=1 augmented=1 --train 4000 --minutes 2 --checks 1 --compile --drape --out runs/T2-one_view
$TRAIN --model picture_parameters --task T2 --set width=256 heads=8 layers=4 augmented=1 --train 8000 --minutes 8 --checks 2 --validate 500 --compile --out runs/T2-8k
$TRAIN --model picture_parameters --task T2 --set width=256 heads=8 layers=4 augmented=1 --train 29064 --minutes 10.2 --checks 3 --validate 500 --compile --out runs/T2-29k
$TRAIN --model typical --task T2 --train 4000 --drape --out runs/T2-reference

$TRAIN --model stitches --task T3 --train 24000 --minutes 5.5 --workers 16 --out runs/T3
$TRAIN --model stitches --task T3 --train 24000 --minutes 5.5 --workers 16 --test-source runs/freesewing --out runs/T3
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 1000 --minutes 2.5 --checks 2 --compile --out runs/T3-1000
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 1000 --minutes 2.5 --checks 2 --compile --test-source runs/freesewing --out runs/T3-1000
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 24000 --minutes 2.5 --checks 2 --compile --out runs/T3-24000
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 24000 --minutes 2.5 --checks 2 --compile --test-source runs/freesewing --out runs/T3-24000
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 24000 --minutes 8 --checks 2 --compile --out runs/T3-long
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 24000 --minutes 8 --checks 2 --compile --test-source runs/freesewing --out runs/T3-long
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 36000 --minutes 8.5 --checks 2 --validate 500 --compile --out runs/T3-kept
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 36000 --minutes 8.5 --checks 2 --validate 500 --compile --seed 1 --out runs/T3-seed1
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 36000 --minutes 11 --checks 2 --validate 500 --compile --seed 2 --out runs/T3-seed2
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 64 --steps 0 --weights benchmarks/reconstruction/weights/T3.pt --out runs/T3-again
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 64 --steps 0 --weights benchmarks/reconstruction/weights/T3.pt --test-source runs/freesewing --out runs/T3-again
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 4000 --steps 1500 --compile --out runs/families-T3-all
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 4000 --minutes 2.5 --checks 2 --compile --out runs/T3-4000
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 4000 --minutes 2.5 --checks 2 --compile --test-source runs/freesewing --out runs/T3-4000
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 4000 --leave-out dress --steps 1500 --compile --out runs/families-T3-dress
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 4000 --leave-out jumpsuit --steps 1500 --compile --out runs/families-T3-jumpsuit
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 4000 --leave-out pants --steps 1500 --compile --out runs/families-T3-pants
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 4000 --leave-out skirt --steps 1500 --compile --out runs/families-T3-skirt
$TRAIN --model stitches --task T3 --set foreign=0.1 --train 4000 --leave-out upper_garment --steps 1500 --compile --out runs/families-T3-upper_garment

$TRAIN --model nearest_labels --task T4 --train 4000 --out runs/T4-reference
$TRAIN --model segmentation --task T4 --train 4000 --minutes 2 --out runs/T4
$TRAIN --model segmentation --task T4 --train 4000 --steps 600 --checks 1 --out runs/families-T4-all
$TRAIN --model segmentation --task T4 --train 4000 --leave-out dress --steps 600 --checks 1 --out runs/families-T4-dress
$TRAIN --model segmentation --task T4 --train 4000 --leave-out jumpsuit --steps 600 --checks 1 --out runs/families-T4-jumpsuit
$TRAIN --model segmentation --task T4 --train 4000 --leave-out pants --steps 600 --checks 1 --out runs/families-T4-pants
$TRAIN --model segmentation --task T4 --train 4000 --leave-out skirt --steps 600 --checks 1 --out runs/families-T4-skirt
$TRAIN --model segmentation --task T4 --train 4000 --leave-out upper_garment --steps 600 --checks 1 --out runs/families-T4-upper_garment
$TRAIN --model segmentation --task T4 --train 8000 --minutes 6 --checks 1 --out runs/T4-long

$TRAIN --model mean_measures --task T5 --train 4000 --out runs/T5-reference-mean_measures
$TRAIN --model measures --task T5 --train 4000 --steps 1000 --checks 1 --out runs/families-T5-all
$TRAIN --model measures --task T5 --train 4000 --minutes 2 --checks 1 --out runs/T5-4k-measures
$TRAIN --model measures --task T5 --train 8000 --minutes 3 --checks 2 --validate 500 --compile --out runs/T5-8k
$TRAIN --model measures --task T5 --train 12000 --minutes 8 --checks 2 --validate 500 --compile --out runs/T5-12k
$TRAIN --model measures --task T5 --train 64 --steps 0 --weights benchmarks/reconstruction/weights/T5.pt --out runs/T5-again
$TRAIN --model measures --task T5 --train 4000 --leave-out dress --steps 1000 --checks 1 --out runs/families-T5-dress
$TRAIN --model measures --task T5 --train 4000 --leave-out jumpsuit --steps 1000 --checks 1 --out runs/families-T5-jumpsuit
$TRAIN --model measures --task T5 --train 4000 --leave-out pants --steps 1000 --checks 1 --out runs/families-T5-pants
$TRAIN --model measures --task T5 --train 4000 --leave-out skirt --steps 1000 --checks 1 --out runs/families-T5-skirt
$TRAIN --model measures --task T5 --train 4000 --leave-out upper_garment --steps 1000 --checks 1 --out runs/families-T5-upper_garment
$TRAIN --model nearest_measures --task T5 --train 4000 --out runs/T5-reference-nearest_measures

$TRAIN --model box_mesh --task T6 --train 4000 --out runs/T6-reference-box_mesh
$TRAIN --model coarse_drape --task T6 --train 4000 --out runs/T6-reference-coarse_drape
$TRAIN --model drape_surrogate --task T6 --train 1000 --minutes 2 --checks 1 --out runs/T6-sizes
$TRAIN --model drape_surrogate --task T6 --train 4000 --minutes 2 --out runs/T6
$TRAIN --model drape_surrogate --task T6 --train 4000 --set coarse=3 --minutes 5 --checks 2 --compile --out runs/T6-coarse
$TRAIN --model drape_surrogate --task T6 --train 4000 --steps 500 --checks 1 --out runs/families-T6-all
$TRAIN --model drape_surrogate --task T6 --train 4000 --leave-out dress --steps 500 --checks 1 --out runs/families-T6-dress
$TRAIN --model drape_surrogate --task T6 --train 4000 --leave-out jumpsuit --steps 500 --checks 1 --out runs/families-T6-jumpsuit
$TRAIN --model drape_surrogate --task T6 --train 4000 --leave-out pants --steps 500 --checks 1 --out runs/families-T6-pants
$TRAIN --model drape_surrogate --task T6 --train 4000 --leave-out skirt --steps 500 --checks 1 --out runs/families-T6-skirt
$TRAIN --model drape_surrogate --task T6 --train 4000 --leave-out upper_garment --steps 500 --checks 1 --out runs/families-T6-upper_garment
$TRAIN --model solver --task T6 --train 4000 --out runs/T6-reference-solver

$TRAIN --model mean_measures --task T7 --train 4000 --out runs/T7-reference-mean_measures
$TRAIN --model nearest_fit --task T7 --train 4000 --out runs/T7-reference-nearest_fit
$TRAIN --model fit --task T7 --train 4000 --minutes 2 --compile --out runs/T7
$TRAIN --model fit --task T7 --train 16000 --minutes 8 --compile --validate 500 --out runs/T7-long

$TRAIN --model motion_residual --task T8 --train 400 --minutes 2.5 --checks 2 --out runs/T8
