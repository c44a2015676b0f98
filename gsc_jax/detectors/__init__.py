"""2D tampering detectors: folders of masks, ONNX networks, SAFIRE, and a cache of their outputs."""
