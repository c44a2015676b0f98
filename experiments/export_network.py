"""Export a published detector to ONNX, with weights of its authors or with random ones.

    pip install imdlbenco onnxscript onnxruntime     (in an environment of its own)
    python experiments/export_network.py trufor --weights trufor.pth.tar --out trufor.onnx

IML-ViT, MVSS-Net, PSCC-Net and TruFor come from the model zoo of IMDL-BenCo; SAFIRE from its own
repository, so run it there. The export is compared with the network on random images. This program
imports nothing of gsc_jax, which needs a newer NumPy.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
# Neither torch nor IMDL-BenCo is installed where types are checked.

import argparse
import importlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torch import Tensor, nn

Weights = Sequence[dict[str, Tensor]]
ZOO = "IMDLBenCo.model_zoo"
SIDE = 1024
"""Side of the images of IML-ViT and SAFIRE."""


class Network(nn.Module):
    """A module with a function of its own as the forward pass."""

    def __init__(self, function: Callable[..., object], **parts: nn.Module) -> None:
        super().__init__()
        self.function, self.parts = function, nn.ModuleDict(parts)

    def forward(self, *inputs: Tensor) -> object:
        """Outputs of the network."""
        return self.function(*inputs)


def iml_vit(weights: Weights) -> nn.Module:
    """Probabilities; without the losses, which its own forward pass computes, too."""
    net = importlib.import_module(f"{ZOO}.iml_vit.iml_vit").IML_ViT()
    load([net], weights)

    def forward(image: Tensor) -> Tensor:
        logits = net.forward_features(image)
        return nn.functional.interpolate(logits, (SIDE, SIDE), mode="bilinear").sigmoid()

    return Network(forward, net=net)


def mvss_net(weights: Weights) -> nn.Module:
    """Logits of the edges and of the map."""
    module = importlib.import_module(f"{ZOO}.mvss_net.mvssnet")
    module.model_zoo.load_url = lambda *_, **__: {}  # weights of ResNet that are replaced below
    # Its forward pass ends with the losses; here, with the outputs in place of the map.
    module.predict_loss = lambda out_edge, out_mask, **_: (0, 0, 0, 0, (out_edge, out_mask), 0, 0)
    net = module.MVSSNet()
    load([net], weights)
    # Every pass normalises these weights in place; once is enough.
    kernel = net.constrain_conv.bayarConstraint().detach()
    net.constrain_conv.bayarConstraint = lambda: kernel
    none = torch.zeros(1)
    return Network(lambda image: net(image, none, none, none)["pred_mask"], net=net)


def pscc_net(weights: Weights) -> nn.Module:
    """Probabilities. Weights: HRNet.pth and NLCDetection.pth."""
    net = importlib.import_module(f"{ZOO}.pscc_net.pscc_net").PSCC_Net(pretrain_path="")
    load([net.FENet, net.SegNet], weights)
    # The zoo leaves out the sigmoid of each scale, which gates the next one in the authors' code.
    for name in ("getmask1", "getmask2", "getmask3", "getmask4"):
        scale = getattr(net.SegNet, name)
        scale.register_forward_hook(lambda _, __, found: (found[0].sigmoid(), found[1]))

    def forward(image: Tensor) -> Tensor:
        size = image.shape[2:]
        coarse = net.SegNet(net.FENet(image))[0]
        return nn.functional.interpolate(coarse, size, mode="bilinear", align_corners=True)

    return Network(forward, net=net)


def trufor(weights: Weights) -> nn.Module:
    """Logits of two channels, authentic and tampered."""
    package = importlib.import_module("IMDLBenCo")
    settings = importlib.import_module(f"{ZOO}.trufor.config")
    folder = Path(str(package.__file__)).parent / "statics/model_zoo/configs"
    settings.update_config(settings._C, None, str(folder / "trufor.yaml"))
    net = importlib.import_module(f"{ZOO}.trufor.cmx.builder_np_conf").myEncoderDecoder(settings._C)
    load([net], weights)
    return Network(lambda image: net(image)[0], net=net)


def safire_encoder(weights: Weights) -> nn.Module:
    """Embeddings of an image."""
    encoder = safire(weights).image_encoder
    apply = high_pass(SIDE)
    encoder.fft_and_ifft = apply
    return encoder


def safire_decoder(weights: Weights) -> nn.Module:
    """Masks and confidences of points, given the embeddings."""
    net = safire(weights)
    prompts, masks = net.prompt_encoder, net.mask_decoder

    def forward(embeddings: Tensor, point_coords: Tensor, point_labels: Tensor) -> object:
        sparse, dense = prompts(points=(point_coords, point_labels), boxes=None, masks=None)
        return masks(
            image_embeddings=embeddings,
            image_pe=prompts.get_dense_pe(),
            sparse_prompt_embeddings=sparse,
            dense_prompt_embeddings=dense,
            multimask_output=False,
        )

    return Network(forward, prompts=prompts, masks=masks)


def safire(weights: Weights) -> nn.Module:
    """The network of SAFIRE; the weights are the file safire.pth."""
    module = importlib.import_module("networks.safire_model")
    sam = importlib.import_module("segment_anything").sam_model_registry["vit_b_adaptor"]()
    # The second version of its code has another name for the class.
    kind = getattr(module, "AdaptorSAM", None) or module.AdaptorMedSAM
    net = kind(sam.image_encoder, sam.mask_decoder, sam.prompt_encoder)
    load([net], weights)
    return net


def high_pass(side: int) -> Callable[[Tensor], Tensor]:
    """The high-pass filter of SAFIRE as products of matrices: ONNX has no FFT of CUDA tensors."""
    frequency = torch.fft.fftfreq(side, dtype=torch.float64) * side
    low = (frequency >= -(side // 4)) & (frequency < side // 4)
    spectrum = torch.fft.fft(torch.eye(side, dtype=torch.float64))
    keep = torch.fft.ifft(low[:, None] * spectrum, dim=0)
    real, imaginary = keep.real.float(), keep.imag.float()

    def apply(image: Tensor) -> Tensor:
        low_pass = real @ image @ real.T - imaginary @ image @ imaginary.T
        return (image - low_pass).abs()

    return apply


def read(path: Path) -> dict[str, Tensor]:
    """Weights of a checkpoint; it is a pickle, of which only tensors are read."""
    state = torch.load(path, map_location="cpu", weights_only=True)
    for key in ("state_dict", "model"):
        state = state.get(key, state)
    return {name.removeprefix("module."): value for name, value in state.items()}


def load(networks: Sequence[nn.Module], weights: Weights) -> None:
    """Load the weights of each network; without any, spread the random ones of normalisation."""
    for net, state in zip(networks, weights, strict=bool(weights)):
        net.load_state_dict(state)
    if not weights:
        for net in networks:
            randomise(net)


def randomise(net: nn.Module) -> None:
    """Make biases and statistics random, which are 0 and 1 at first and would hide errors."""
    for name, value in [*net.named_parameters(), *net.named_buffers()]:
        if value.is_floating_point() and name.endswith(("bias", "running_mean", "gamma_s", "beta")):
            nn.init.normal_(value, std=0.1)
        elif name.endswith("running_var"):
            nn.init.uniform_(value, 0.5, 2)


def images(height: int, width: int) -> tuple[Tensor, ...]:
    """An example of an input."""
    return (torch.rand(1, 3, height, width),)


def prompts() -> tuple[Tensor, ...]:
    """An example of the inputs of the decoder of SAFIRE, with two points."""
    return torch.randn(1, 256, 64, 64), SIDE * torch.rand(2, 1, 2), torch.ones(2, 1)


NETWORKS: dict[str, tuple[Callable[[Weights], nn.Module], tuple[int, int] | None]] = {
    "iml-vit": (iml_vit, (SIDE, SIDE)),
    "mvss-net": (mvss_net, (512, 512)),
    "pscc-net": (pscc_net, None),
    "trufor": (trufor, None),
    "safire-encoder": (safire_encoder, (SIDE, SIDE)),
    "safire-decoder": (safire_decoder, None),
}
"""Network and the size of its images; None where it is free."""
OUTPUTS = {
    "mvss-net": ["edges", "map"],
    "safire-encoder": ["embeddings"],
    "safire-decoder": ["masks", "confidences"],
}


def export(name: str, weights: Weights, size: tuple[int, int], path: Path) -> None:
    """Write a network to a file and print how far the file is from the network."""
    build, fixed = NETWORKS[name]
    example, names = images(*(fixed or size)), ["image"]
    free: tuple | None = None
    if name == "safire-decoder":
        example, names = prompts(), ["embeddings", "point_coords", "point_labels"]
        free = (None, {0: torch.export.Dim("points")}, {0: torch.export.Dim("points")})
    torch.manual_seed(0)
    net = build(weights).eval()
    with torch.no_grad():
        torch.onnx.export(
            net,
            example,
            str(path),
            input_names=names,
            output_names=OUTPUTS.get(name, ["map"]),
            dynamic_shapes=(free,) if free else None,  # the inputs are one variadic argument
            dynamo=True,  # the older exporter cannot run the prompt encoder of SAFIRE
        )
        wanted = net(*example)
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    fed = {key: value.numpy() for key, value in zip(names, example, strict=True)}
    found = session.run(None, fed)
    wanted = [wanted] if torch.is_tensor(wanted) else wanted
    for output, have, want in zip(session.get_outputs(), found, wanted, strict=True):
        error = np.abs(have - want.numpy()).max()
        spread = float(want.std())
        print(f"{output.name} {have.shape}: differs by {error:.1e}, values spread by {spread:.1e}")


def main() -> None:
    """Read the command line and export."""
    text = argparse.RawTextHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=text)
    parser.add_argument("network", choices=list(NETWORKS))
    parser.add_argument("--weights", type=Path, nargs="*", default=[], help="none: random ones")
    parser.add_argument("--size", type=int, nargs=2, default=(480, 640), help="height, width")
    parser.add_argument("--out", type=Path, required=True, help="file to write, .onnx")
    options = parser.parse_args()
    weights = [read(path) for path in options.weights]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    export(options.network, weights, tuple(options.size), options.out)


if __name__ == "__main__":
    main()
