#!/bin/bash
# The trainings of the bundled models; in zsh, run "setopt shwordsplit noglob" first.
# The photographs in photos/rgb, 9,000 of rooms by many cameras, are not part of the project; IMAGES is
# a folder with the 866 training images of NYU Depth v2. The narrower decoder (NARROW) needs depthcli 0.15.
set -e
depthcli train proposed --preset bundled --data NYU --out runs/default
depthcli export-onnx runs/default/last.ckpt -o runs/1.1/ --fp16
depthcli export-onnx runs/default/last.ckpt -o runs/teacher/ --mirror
depthcli batch photos/rgb -o photos/depth --model runs/teacher --upsample bilinear --format png16
TUNE="--preset finetune --data NYU --set generator.decoder=[128,96,64,48]"
SMALL="--set data.width=192 --set data.height=144"
depthcli train proposed $TUNE $SMALL --pseudo-labels photos --init runs/1.1/model.onnx --set optim.epochs_decay=40 --out runs/wide
depthcli export-onnx runs/wide/last.ckpt -o runs/wide/ --fp16
WIDE="$TUNE --set data.zoom=2.0 --set data.aspects=[1.7778,2.3333,1.0,0.75,0.5625]"
depthcli train proposed $WIDE $SMALL --pseudo-labels photos --init runs/wide/model.onnx --set seed=1 --set optim.epochs_decay=48 --set optim.learning_rate=2e-4 --out runs/wider
depthcli export-onnx runs/wider/last.ckpt -o runs/1.2/ --fp16

python benchmarks/label_photographs.py photos/rgb photos2 --model runs/1.1 --model runs/1.2
depthcli train proposed $TUNE --pseudo-labels photos2 --init runs/1.2/model.onnx --set optim.epochs_decay=40 --set optim.learning_rate=2e-4 --out runs/large
WIDE="$WIDE --pseudo-labels photos2 --set optim.learning_rate=1e-4 --set optim.warmup_steps=50"
LARGER="$WIDE --set optim.epochs_decay=24 --set seed=7"
SMALLER="$WIDE $SMALL --set optim.epochs_decay=12 --set seed=8"
NARROW="--set generator.decoder=[128,96,48,16] --max-minutes 0"

depthcli train proposed $LARGER --init runs/large/last.ckpt --out runs/larger-866
depthcli train proposed $LARGER $NARROW --init runs/larger-866/last.ckpt --out runs/last-866
depthcli train proposed $SMALLER --init runs/larger-866/last.ckpt --out runs/smaller-866
depthcli train proposed $SMALLER $NARROW --init runs/smaller-866/last.ckpt --out runs/fast-866
depthcli export-onnx runs/last-866/last.ckpt -o runs/last-866/ --int8 IMAGES   # for float: --fp16 in place of --int8 IMAGES
depthcli export-onnx runs/fast-866/last.ckpt -o runs/fast-866/ --int8 IMAGES

# The bundled weights: the same from runs/larger-866 on with all 1000 pairs.
ALL="--set data.holdout_every=0"
depthcli train proposed $LARGER $ALL --init runs/large/last.ckpt --out runs/larger
depthcli train proposed $LARGER $ALL $NARROW --init runs/larger/last.ckpt --out runs/last
depthcli train proposed $SMALLER $ALL --init runs/larger/last.ckpt --out runs/smaller
depthcli train proposed $SMALLER $ALL $NARROW --init runs/smaller/last.ckpt --out runs/fast
depthcli export-onnx runs/last/last.ckpt -o models/default/ --name default --model-version 3.1.0 --license MIT --int8 IMAGES --float-model float
depthcli export-onnx runs/last/last.ckpt -o models/float/ --name float --model-version 3.1.0 --license MIT --fp16
depthcli export-onnx runs/fast/last.ckpt -o models/fast/ --name fast --model-version 3.1.0 --license MIT --int8 IMAGES --float-model float
