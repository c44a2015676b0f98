"""The steps of published detectors around their network, written again in NumPy, pixel by pixel.

Each takes an 8-bit image and a function that computes the network, and follows the inference code
of its authors: reading, resizing, normalisation, and what becomes of the outputs. Nothing of the
package is used.
"""

import math

import numpy as np

MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
SAM_MEAN, SAM_DEVIATION = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)


def bilinear(values, height, width):
    """`cv2.resize` and torch's `interpolate` with align_corners=False: no low-pass, no mirror."""
    values = np.asarray(values, np.float64)
    rows, columns = values.shape[:2]
    found = np.empty((height, width, *values.shape[2:]))
    for y in range(height):
        v = min(max((y + 0.5) * rows / height - 0.5, 0), rows - 1)
        top, bottom = math.floor(v), min(math.floor(v) + 1, rows - 1)
        for x in range(width):
            u = min(max((x + 0.5) * columns / width - 0.5, 0), columns - 1)
            left, right = math.floor(u), min(math.floor(u) + 1, columns - 1)
            upper = values[top, left] * (1 - u + left) + values[top, right] * (u - left)
            lower = values[bottom, left] * (1 - u + left) + values[bottom, right] * (u - left)
            found[y, x] = upper * (1 - v + top) + lower * (v - top)
    return found


def tensor(values, mean=(0, 0, 0), deviation=(1, 1, 1)):
    """Normalise an image (H, W, 3) and make it a batch (1, 3, H, W)."""
    planes = [(values[..., c] - mean[c]) / deviation[c] for c in range(3)]
    return np.stack(planes)[None]


def iml_vit(levels, network):
    """Pad with black to 1024 x 1024, normalise, and crop the map."""
    height, width = levels.shape[:2]
    padded = np.zeros((1024, 1024, 3))
    padded[:height, :width] = levels / 255
    return network(tensor(padded, MEAN, DEVIATION))[0][0, 0, :height, :width]


def trufor(levels, network):
    """Levels are divided by 256; the map is the second channel of a softmax."""
    logits = network(tensor(levels / 256))[0][0]
    powers = np.exp(logits - logits.max(axis=0))
    return powers[1] / powers.sum(axis=0)


def mvss_net(levels, network):
    """BGR of cv2, 512 x 512 in 8 bits, normalised by the statistics of RGB; the second output."""
    square = np.rint(bilinear(levels[..., ::-1], 512, 512))
    logits = network(tensor(square / 255, MEAN, DEVIATION))[1][0, 0]
    return 1 / (1 + np.exp(-logits))


def pscc_net(levels, network):
    """Levels are divided by 255, and the network does the rest."""
    return network(tensor(levels / 255))[0][0, 0]


def safire(levels, encoder, decoder, side, grid):
    """Masks of a grid of points, in two groups by the cosines of the embeddings inside them."""
    square = bilinear(levels, side, side)
    embeddings = encoder(tensor(square, SAM_MEAN, SAM_DEVIATION))[0]
    cells = embeddings.shape[2]
    masks, confidences, features = [], [], []
    for j in range(grid):
        for i in range(grid):
            point = [[[(i + 0.5) * side / grid, (j + 0.5) * side / grid]]]
            logits, confidence = decoder(embeddings, np.array(point), np.ones((1, 1)))
            mask = bilinear(logits[0, 0], side, side)
            inside = [
                embeddings[0, :, y, x]
                for y in range(cells)
                for x in range(cells)
                if mask[y * side // cells, x * side // cells] > 0
            ]
            mean = np.mean(inside, axis=0)
            features.append(mean / np.linalg.norm(mean))
            masks.append(mask)
            confidences.append(confidence[0, 0])
    groups = best_groups(np.array(features))
    best = []
    for k in (0, 1):
        members = [index for index in range(len(masks)) if groups[index] == k]
        best.append(max(members, key=lambda index: confidences[index]))
    forged, rest = sorted(best, key=lambda index: (masks[index] > 0).sum())
    inside, outside = (1 / (1 + np.exp(-masks[index])) for index in (forged, rest))
    return (inside + 1 - outside) / 2


def best_groups(features):
    """Two groups by cosine: Lloyd's iteration from every pair of members, and the best of them."""
    best, highest = np.zeros(len(features), int), -np.inf
    for a in range(len(features)):
        for b in range(a):
            centres, groups, length = features[[a, b]], best, -np.inf
            for _ in range(50):
                groups = (features @ centres.T).argmax(axis=1)
                sums = [features[groups == k].sum(axis=0) for k in (0, 1)]
                length = sum(np.linalg.norm(s) for s in sums)
                if min(np.linalg.norm(s) for s in sums) == 0:
                    break
                centres = np.stack([s / np.linalg.norm(s) for s in sums])
            if length > highest:
                best, highest = groups, length
    return best
