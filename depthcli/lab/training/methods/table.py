"""The methods and presets by name; imports nothing, for use in help texts and completion."""

PAPER_METHODS = {  #: name -> ``module:class``, in the order of the paper's Table I
    "cyclegan": "cyclegan:CycleGan",
    "cut": "cut:Cut",
    "fastcut": "cut:Cut",
    "dclgan": "dclgan:DclGan",
    "simdcl": "dclgan:SimDcl",
    "hnegsrc": "cut:HnegSrc",
    "proposed": "proposed:Proposed",
}

METHODS = PAPER_METHODS | {"prompted": "prompted:Prompted"}  #: all methods

PRESETS = {  #: TOML files in ``training/presets``, and the method that each is for; "" for all
    "paper": "",
    "paper-small": "",
    "reduced": "",
    "bundled": "proposed",
    "finetune": "proposed",
}
