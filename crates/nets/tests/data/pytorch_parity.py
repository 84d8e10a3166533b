"""Writes pytorch_parity.json: outputs, states and all gradients of small GRU and MLP nets, and steps of Adam.

    pip install torch numpy
    python pytorch_parity.py pytorch_parity.json

Made with torch 2.15.0 in double precision on the processor; parameters and features are exact in single precision.
"""

import json
import sys

import torch


def exact(generator, *shape, scale=1.0):
    """Multiples of 1/1024 in [-scale, scale): the same number in single and double precision."""
    whole = torch.randint(-1024, 1024, shape, generator=generator)
    return whole.double() * (scale / 1024)


def flat(tensor):
    return [float(f"{x:.12g}") for x in tensor.detach().reshape(-1).tolist()]


class Gru(torch.nn.Module):
    def __init__(self, inputs, hidden, layers, outputs):
        super().__init__()
        self.gru = torch.nn.GRU(inputs, hidden, layers)
        self.head = torch.nn.Linear(hidden, outputs)

    def forward(self, x, state):
        y, after = self.gru(x, state)
        return self.head(y), after


class Mlp(torch.nn.Module):
    def __init__(self, widths, activation):
        super().__init__()
        self.layers = torch.nn.ModuleList(torch.nn.Linear(a, b) for a, b in zip(widths, widths[1:]))
        self.activation = activation

    def forward(self, x):
        for layer in self.layers[:-1]:
            x = self.activation(layer(x))
        return self.layers[-1](x)


def fill(net, generator):
    for p in net.parameters():
        p.data = exact(generator, *p.shape, scale=0.5)


def tensors(net):
    return [{"name": k, "shape": list(p.shape), "value": flat(p), "gradient": flat(p.grad)} for k, p in net.named_parameters()]


def gru_case(generator):
    steps, batch, inputs, hidden, layers, outputs = 4, 3, 5, 6, 2, 7
    net = Gru(inputs, hidden, layers, outputs).double()
    fill(net, generator)
    x = exact(generator, steps, batch, inputs, scale=2.0).requires_grad_()
    state = exact(generator, layers, batch, hidden)
    dy = exact(generator, steps, batch, outputs)
    y, after = net(x, state)
    y.backward(dy)
    return {
        "steps": steps, "batch": batch, "inputs": inputs, "outputs": outputs, "layers": layers, "hidden": hidden,
        "features": flat(x), "state_before": flat(state.transpose(0, 1)), "output_gradient": flat(dy),
        "output": flat(y), "state_after": flat(after.transpose(0, 1)), "feature_gradient": flat(x.grad),
        "tensors": tensors(net),
    }


def mlp_case(generator, name, activation):
    steps, batch, inputs, hidden, outputs = 2, 3, 5, [6, 4], 7
    net = Mlp([inputs, *hidden, outputs], activation).double()
    fill(net, generator)
    x = exact(generator, steps, batch, inputs, scale=2.0).requires_grad_()
    dy = exact(generator, steps, batch, outputs)
    y = net(x)
    y.backward(dy)
    return {
        "activation": name, "steps": steps, "batch": batch, "inputs": inputs, "outputs": outputs, "hidden": hidden,
        "features": flat(x), "output_gradient": flat(dy), "output": flat(y), "feature_gradient": flat(x.grad),
        "tensors": tensors(net),
    }


def adam_case(generator):
    p = exact(generator, 20).requires_grad_()
    optimiser = torch.optim.Adam([p], lr=0.01)
    case = {"learning_rate": 0.01, "clip_norm": 1.5, "start": flat(p), "gradients": [], "norms": [], "parameters": []}
    for scale in [1.0, 0.25, 2.0, 0.0625]:
        p.grad = exact(generator, 20, scale=scale)
        case["gradients"].append(flat(p.grad))
        case["norms"].append(float(torch.nn.utils.clip_grad_norm_([p], 1.5)))
        optimiser.step()
        case["parameters"].append(flat(p))
    return case


generator = torch.Generator().manual_seed(5)
cases = {
    "made_with": f"torch {torch.__version__.split('+')[0]}, float64",
    "gru": gru_case(generator),
    "mlp": [
        mlp_case(generator, "silu", torch.nn.functional.silu),
        mlp_case(generator, "tanh", torch.tanh),
        mlp_case(generator, "relu", torch.relu),
    ],
    "adam": adam_case(generator),
}
with open(sys.argv[1], "w", encoding="utf-8") as out:
    json.dump(cases, out, separators=(",", ":"))
    out.write("\n")
