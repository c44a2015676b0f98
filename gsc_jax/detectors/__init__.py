"""2D tampering detectors: a folder of masks, an ONNX network."""
