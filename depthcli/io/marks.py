"""Marks of the files that depthcli writes, by which it recognizes them; imports nothing."""

KEY_PREFIX = "depthcli:"  #: start of the names of texts in PNG, EXR and PLY
SOFTWARE_KEY = f"{KEY_PREFIX}software"  #: a text in every PNG (after its header) and EXR
LABEL_PREFIX = "DEPTHCLI_"  #: start of the names of the labels in a depth video
COMMENT_PREFIX = "written by depthcli "  #: start of the comment in a preview or stereo video
EXR_MARK = f"{SOFTWARE_KEY}\0string\0".encode()  #: within the first 4,096 bytes of an EXR
