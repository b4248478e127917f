"""What every field, binder, appearance, rasteriser, loss and constraint must keep to."""

import math
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from sculpt_framework.appearances import bands
from sculpt_framework.binders import Binder, Binding
from sculpt_framework.config import (
    AppearanceConfig,
    BinderConfig,
    ConstraintConfig,
    ExtractorConfig,
    FieldConfig,
    LossConfig,
    RasterizerConfig,
)
from sculpt_framework.geometry.band import discover
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.losses import ImageLoss, Target, TrainingImage, ViewsLoss
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.testing.extraction import box_sdf, require, sphere_sdf
from sculpt_framework.types import Camera, Gaussians, Rendering, Surface

# --------------------------------------------------------------------------------------------------------------- fields


def check_field(config: FieldConfig, device: torch.device | None = None) -> None:
    """Check the contract of slot ``field``: finite, differentiable, and a ball as built."""
    device = device or torch.device("cpu")
    torch.manual_seed(0)
    field = config.build(40, device)
    field.set_detail(2.0 / 40)
    far = torch.tensor([[0.0, 0.0, 0.0], [1.0, -1.0, 1.0], [1e3, 0.0, 0.0], [-1e6, 1e6, 1e6]], device=device)
    sdf = field(far)
    require(sdf.shape == (4,), f"sdf of 4 points has shape {tuple(sdf.shape)}")
    require(bool(torch.isfinite(sdf).all()), "far points are not finite")
    require(field(far[:0]).shape == (0,), "no points give no empty answer")
    directions = torch.nn.functional.normalize(torch.randn(500, 3, device=device), dim=1)
    with torch.no_grad():
        require(float(field(0.02 * directions).max()) < 0, "as built, the centre is not inside")
        require(float(field(directions).mean()) > 0.1, "as built, the unit sphere is not outside")

    points = (0.5 * directions).requires_grad_()
    (slope,) = torch.autograd.grad(field(points).sum(), [points])
    outward = (slope * directions).sum(dim=1)
    require(bool(torch.isfinite(slope).all()), "the gradient by the points is not finite")
    require(
        0.5 < float(outward.mean()) < 2.0, f"as built, the sdf grows by {float(outward.mean()):.2f} per unit outwards"
    )
    field(points).square().sum().backward()
    grouped = [parameter for group in field.parameter_groups() for parameter in group.parameters]
    owned = [parameter for parameter in field.parameters() if parameter.requires_grad]
    require(len(grouped) == len({id(each) for each in grouped}), "a parameter is in two groups")
    require({id(each) for each in grouped} == {id(each) for each in owned}, "the groups do not hold all parameters")
    fitted = [parameter for group in field.fit_groups() for parameter in group.parameters]
    require({id(each) for each in fitted} == {id(each) for each in owned}, "the groups of fitting miss parameters")
    groups = [*field.parameter_groups(), *field.fit_groups()]
    require(all(group.rate > 0 for group in groups), "a rate is not positive")
    learned = [each.grad for each in grouped if each.grad is not None]
    require(any(bool(gradient.any()) for gradient in learned), "no parameter gets a gradient from the sdf")
    require(all(bool(torch.isfinite(gradient).all()) for gradient in learned), "a parameter's gradient is not finite")


# ------------------------------------------------------------------------------------------------- binders, appearances


def tetrahedron(dtype: torch.dtype = torch.float32, device: torch.device | None = None) -> Surface:
    """A closed surface of four faces round the origin."""
    vertices = torch.tensor([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=dtype, device=device)
    faces = torch.tensor([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], device=device)
    return Surface(vertices=0.4 * vertices, faces=faces, face_keys=torch.arange(4, device=device))


def squashed(surface: Surface) -> Surface:
    """The same surface with a face of no area and one that is nearly a line."""
    vertices = surface.vertices.detach().clone()
    vertices[1], vertices[2] = vertices[0], vertices[0] + 1e-7
    return Surface(vertices=vertices, faces=surface.faces, face_keys=surface.face_keys)


def _bind(binder: Binder, surface: Surface) -> tuple[Binding, dict[str, Tensor]]:
    rows = binder.new_rows(len(surface.faces), surface.vertices.device, surface.vertices.dtype)
    rows = {name: row.clone().requires_grad_() for name, row in rows.items()}
    return binder.bind(surface, rows, blur=0.01), rows


def _binding_tensors(binding: Binding) -> dict[str, Tensor]:
    return {"means": binding.means, "scales": binding.scales, "rotations": binding.rotations} | {
        "opacities": binding.opacities,
        "barycentrics": binding.barycentrics,
        "tangent_covariance": binding.tangent_covariance,
        "tangent_corners": binding.tangent_corners,
    }


def check_binder(config: BinderConfig, device: torch.device | None = None) -> None:
    """Check the contract of slot ``binder``: Gaussians that ride on their faces, finite for any triangle."""
    binder, surface = config.build(), tetrahedron(device=device)
    faces, k = len(surface.faces), binder.gaussians_per_face
    surface = Surface(
        vertices=surface.vertices.clone().requires_grad_(), faces=surface.faces, face_keys=surface.face_keys
    )
    binding, rows = _bind(binder, surface)
    require(set(rows) == set(binder.rates), "new_rows and rates name different parameters")
    require(all(row.shape[0] == faces for row in rows.values()), "a row parameter is not one row per face")
    require(binding.means.shape == (faces, k, 3), f"means have shape {tuple(binding.means.shape)}")
    weights = binding.barycentrics
    require(bool((weights >= 0).all()), "a barycentric coordinate is negative")
    require(torch.allclose(weights.sum(dim=2), torch.ones_like(weights[..., 0]), atol=1e-5), "barycentrics miss one")
    require(bool(((binding.opacities > 0) & (binding.opacities < 1)).all()), "an opacity is not in (0, 1)")
    lengths = binding.rotations.norm(dim=2)
    require(torch.allclose(lengths, torch.ones_like(lengths), atol=1e-4), "columns of a rotation are not unit vectors")
    outward = (binding.rotations[..., 0] * binding.means).sum(dim=2)
    require(bool((outward > 0).all()), "column 0 of a rotation is not the outward normal")
    require(bool((binding.scales > 0).all()), "a scale is not positive")

    total = binding.means.sum() + binding.scales.log().sum() + binding.rotations[..., 1].square().sum()
    (slope,) = torch.autograd.grad(total, [surface.vertices], retain_graph=True)
    require(bool(torch.isfinite(slope).all()) and bool(slope.any()), "vertices get no finite gradient")
    moved, _ = _bind(binder, Surface(vertices=surface.vertices + 1.0, faces=surface.faces, face_keys=surface.face_keys))
    require(torch.allclose(moved.means, binding.means + 1.0, atol=1e-5), "Gaussians do not move with their faces")
    require(torch.allclose(moved.scales, binding.scales, rtol=1e-3), "moving a face changes scales")

    flat = squashed(surface)
    flat = Surface(vertices=flat.vertices.requires_grad_(), faces=flat.faces, face_keys=flat.face_keys)
    degenerate, _ = _bind(binder, flat)
    for name, value in _binding_tensors(degenerate).items():
        require(bool(torch.isfinite(value).all()), f"{name} of a face of no area are not finite")
    (slope,) = torch.autograd.grad(degenerate.means.sum() + degenerate.scales.sum(), [flat.vertices])
    require(bool(torch.isfinite(slope).all()), "a face of no area gives a gradient that is not finite")


def check_appearance(config: AppearanceConfig, device: torch.device | None = None) -> None:
    """Check the contract of slot ``appearance``: colours that learn, and never pull on geometry."""
    device = device or torch.device("cpu")
    torch.manual_seed(0)
    appearance = config.build(device)
    means = (torch.rand(6, 2, 3, device=device) - 0.5).requires_grad_()
    rows = appearance.new_rows(means.detach())
    require(set(rows) == set(appearance.rates), "new_rows and rates name different parameters")
    require(all(row.shape[0] == 6 for row in rows.values()), "a row parameter is not one row per face")
    leaves = {name: row.clone().requires_grad_() for name, row in rows.items()}
    sh = appearance(means, leaves)
    expected = (6, 2, bands(appearance.sh_degree), 3)
    require(sh.shape == expected, f"coefficients have shape {tuple(sh.shape)} instead of {expected}")
    require(bool(torch.isfinite(sh).all()), "coefficients are not finite")
    shared = [parameter for group in appearance.parameter_groups() for parameter in group.parameters]
    sh.square().sum().backward(retain_graph=True)
    (sh.sum()).backward()
    require(means.grad is None, "colours have a gradient by positions")
    learned = [each.grad for each in [*leaves.values(), *shared] if each.grad is not None]
    require(any(bool(gradient.any()) for gradient in learned), "nothing learns from the colours")


# ---------------------------------------------------------------------------------------------------------- rasterizers


def camera_at(distance: float, size: int = 24, device: torch.device | None = None) -> Camera:
    """A camera on the negative z axis that looks at the origin; half the field of view is 27 degrees."""
    pose = torch.eye(4, device=device)
    pose[2, 3] = distance
    return Camera(
        world_to_camera=pose, fx=float(size), fy=float(size), cx=size / 2, cy=size / 2, width=size, height=size
    )


def one_gaussian(scale: float = 0.2, device: torch.device | None = None) -> Gaussians:
    """A round red Gaussian at the origin that faces the camera of ``camera_at``."""
    axes = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]], device=device)
    return Gaussians(
        means=torch.zeros(1, 3, device=device),
        scales=torch.tensor([[1e-3, scale, scale]], device=device),
        rotations=axes[None],
        opacities=torch.tensor([0.9], device=device),
        sh=(torch.tensor([[[1.0, 0.0, 0.0]]], device=device) - 0.5) / 0.28209479177387814,
        face=torch.zeros(1, dtype=torch.int64, device=device),
    )


def check_rasterizer(config: RasterizerConfig, device: torch.device | None = None) -> None:
    """Check the contract of slot ``rasterizer`` on cases with a known answer."""
    device = device or torch.device("cpu")
    render, camera, gaussian = _render_on(config.build(device), device), camera_at(3.0, 25), one_gaussian()
    background = torch.tensor([0.2, 0.4, 0.6])
    picture = render(gaussian, camera, background, low_pass_px2=0.0, normals=True)
    require(picture.rgb.shape == (25, 25, 3) and picture.alpha.shape == (25, 25), "the picture has another size")
    center = float(picture.alpha[12, 12])
    require(abs(center - 0.9) < 1e-4, f"a Gaussian of opacity 0.9 covers {center:.4f} of the pixel on its mean")
    # A standard deviation is 0.2 * 25 / 3 pixels.
    expected = 0.9 * float(torch.exp(torch.tensor(-0.5 * (3 / (0.2 * 25 / 3)) ** 2)))
    beside = float(picture.alpha[12, 15])
    require(abs(beside - expected) < 1e-3, f"three pixels beside its mean it covers {beside:.4f}, not {expected:.4f}")
    require(torch.allclose(picture.rgb[0, 0], background, atol=1e-5), "an empty pixel is not the background")
    blend = 0.9 * torch.tensor([1.0, 0.0, 0.0]) + 0.1 * background
    require(torch.allclose(picture.rgb[12, 12], blend, atol=1e-3), "colour and background are not blended by alpha")
    require(abs(float(picture.depth[12, 12]) - 0.9 * 3) < 1e-3, "depth is not the weighted sum of camera z")
    require(picture.normal is not None, "normals were asked for and are None")
    _check_order(render, camera, background)
    _check_slopes(render, camera, background)
    behind = render(_at(gaussian, [0.0, 0.0, -9.0]), camera, background, low_pass_px2=0.0)
    require(not bool(behind.alpha.any()), "a Gaussian behind the camera is drawn")


Render = Callable[..., Rendering]


def _render_on(rasterizer: Rasterizer, device: torch.device) -> Render:
    """``rasterizer.render`` for inputs and results on the CPU."""

    def render(
        gaussians: Gaussians, camera: Camera, background: Tensor, *, low_pass_px2: float, normals: bool = False
    ) -> Rendering:
        there = gaussians.to(device), camera.to(device, torch.float32), background.to(device)
        done = rasterizer.render(*there, low_pass_px2=low_pass_px2, normals=normals)
        normal = None if done.normal is None else done.normal.cpu()
        return Rendering(rgb=done.rgb.cpu(), alpha=done.alpha.cpu(), depth=done.depth.cpu(), normal=normal)

    return render


def _at(gaussians: Gaussians, place: list[float]) -> Gaussians:
    return replace(gaussians, means=torch.tensor([place]))


def _check_order(render: Render, camera: Camera, background: Tensor) -> None:
    """What is nearer hides what is behind it, in whatever order they come."""
    near, far = _at(one_gaussian(), [0.0, 0.0, -0.5]), _at(one_gaussian(), [0.0, 0.0, 0.5])
    blue = (torch.tensor([[[0.0, 0.0, 1.0]]]) - 0.5) / 0.28209479177387814
    pictures = []
    for first, second in ((near, replace(far, sh=blue)), (replace(far, sh=blue), near)):
        pair = Gaussians(
            means=torch.cat([first.means, second.means]),
            scales=torch.cat([first.scales, second.scales]),
            rotations=torch.cat([first.rotations, second.rotations]),
            opacities=torch.cat([first.opacities, second.opacities]),
            sh=torch.cat([first.sh, second.sh]),
            face=torch.arange(2),
        )
        pictures.append(render(pair, camera, background, low_pass_px2=0.3).rgb)
    require(torch.allclose(pictures[0], pictures[1], atol=1e-6), "the order of the Gaussians changes the picture")
    red, blue_share = float(pictures[0][12, 12, 0]), float(pictures[0][12, 12, 2])
    require(red > 0.85 and blue_share < 0.2, "a near Gaussian does not hide the one behind it")


def _check_slopes(render: Render, camera: Camera, background: Tensor) -> None:
    """Gradients against differences, along the shift and the size of a Gaussian."""
    weights = torch.linspace(0, 1, camera.height * camera.width).reshape(camera.height, camera.width)
    # Only the middle: farther out contributions end at a threshold, which differences see and gradients do not.
    offset = torch.arange(camera.height) - camera.height // 2
    weights = weights * (offset[:, None] ** 2 + offset**2 < 3.5**2)

    def total(shift: Tensor, growth: Tensor) -> Tensor:
        moved = replace(
            one_gaussian(),
            means=torch.stack([shift, torch.zeros(()), torch.zeros(())])[None],
            scales=torch.stack([torch.tensor(1e-3), 0.2 * growth, 0.2 * growth])[None],
        )
        return (render(moved, camera, background, low_pass_px2=0.3).alpha * weights).sum()

    def at(shift: float, growth: float) -> float:
        return float(total(torch.tensor(shift), torch.tensor(growth)).detach())

    where = torch.tensor(0.013, requires_grad=True), torch.tensor(1.1, requires_grad=True)
    slopes = torch.autograd.grad(total(*where), where)
    step = 0.02
    differences = (
        (at(0.013 + step, 1.1) - at(0.013 - step, 1.1)) / (2 * step),
        (at(0.013, 1.1 + step) - at(0.013, 1.1 - step)) / (2 * step),
    )
    for name, slope, difference in zip(("a shift", "growth"), slopes, differences, strict=True):
        close = abs(float(slope) - difference) < 0.03 * abs(difference) + 1e-2
        require(close, f"the gradient by {name} is {float(slope):.4f}, differences say {difference:.4f}")


# -------------------------------------------------------------------------------------------------- losses, constraints


def check_loss(config: LossConfig, extractor: ExtractorConfig, device: torch.device | None = None) -> None:
    """Check the contract of slot ``losses``: a finite number, least where there is nothing to mend.

    ``extractor`` makes the surfaces that geometry terms are tried on.
    """
    device = device or torch.device("cpu")
    term = config.build()
    if isinstance(term, ImageLoss):
        torch.manual_seed(0)
        rgb, alpha = torch.rand(20, 24, 3, device=device), (torch.rand(20, 24, device=device) > 0.5).float()
        for mask in (alpha, None):
            same = Rendering(rgb=rgb.clone().requires_grad_(), alpha=alpha.clone().requires_grad_(), depth=alpha)
            other = Rendering(
                rgb=(1 - rgb).clone().requires_grad_(), alpha=(1 - alpha).clone().requires_grad_(), depth=alpha
            )
            least, more = term(same, Target(rgb=rgb, alpha=mask)), term(other, Target(rgb=rgb, alpha=mask))
            require(least.shape == (), "an image term is not one number")
            require(abs(float(least.detach())) < 1e-3, f"a perfect picture costs {float(least.detach()):.4f}")
            require(float(more.detach()) >= float(least.detach()), "a wrong picture costs less than a perfect one")
            for value in (least, more):
                _require_finite_slopes(value, [same.rgb, same.alpha, other.rgb, other.alpha])
        return
    if isinstance(term, ViewsLoss):
        _check_views_loss(term, device)
        return
    grid = grid_over_box(torch.ones(3), cells=12)
    built = extractor.build(grid, device)
    for name, sdf in (("sphere", sphere_sdf(0.6)), ("box", box_sdf())):
        shift = torch.zeros((), device=device, requires_grad=True)
        extraction = built.extract(lambda points, sdf=sdf, shift=shift: sdf(points) - shift, discover(sdf, grid, 0))
        value = term(extraction)
        require(value.shape == (), "a geometry term is not one number")
        require(bool(torch.isfinite(value.detach())), f"{name}: the term is {float(value.detach())}")
        _require_finite_slopes(value, [shift])


def _check_views_loss(term: ViewsLoss, device: torch.device) -> None:
    """On a tetrahedron seen by four cameras side by side, and by one alone."""
    generator = torch.Generator().manual_seed(0)
    cameras = [_turned(camera_at(4.0, device=device), 0.2 * number) for number in range(4)]
    images = [
        TrainingImage(name=str(number), camera=camera, premultiplied=rgb.to(device), alpha=None)
        for number, camera in enumerate(cameras)
        for rgb in (torch.rand(camera.height, camera.width, 3, generator=generator),)
    ]
    for given in (images, images[:1]):
        term.begin(given)
        surface = tetrahedron(device=device)
        vertices = surface.vertices.detach().requires_grad_()
        value = term(replace(surface, vertices=vertices), range(min(term.views, len(given))), 0)
        require(value.shape == (), "a term of views is not one number")
        require(bool(torch.isfinite(value.detach())), f"the term is {float(value.detach())}")
        _require_finite_slopes(value, [vertices])


def _turned(camera: Camera, angle: float) -> Camera:
    """The camera, gone round the origin about the y axis."""
    cosine, sine = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[cosine, 0, sine, 0], [0, 1, 0, 0], [-sine, 0, cosine, 0], [0, 0, 0, 1.0]])
    return replace(camera, world_to_camera=camera.world_to_camera @ turn.to(camera.world_to_camera))


def _require_finite_slopes(value: Tensor, inputs: list[Tensor]) -> None:
    if not value.requires_grad:
        return
    for slope in torch.autograd.grad(value, inputs, allow_unused=True):
        require(slope is None or bool(torch.isfinite(slope).all()), "a gradient is not finite")


def check_constraint(config: ConstraintConfig, binder: BinderConfig, device: torch.device | None = None) -> None:
    """Check the contract of slot ``constraints``: a penalty, never negative, finite for any triangle and any row."""
    term, made = config.build(), binder.build()
    for name, surface in (("a good", tetrahedron(device=device)), ("a flat", squashed(tetrahedron(device=device)))):
        for push in (0.0, 3.0, -20.0):
            binding, rows = _bind(made, surface)
            if push:
                pushed = {
                    n: (r.detach() + push * torch.linspace(-1, 1, r.numel()).reshape(r.shape)) for n, r in rows.items()
                }
                rows = {n: r.requires_grad_() for n, r in pushed.items()}
                binding = made.bind(surface, rows, blur=0.01)
            value = term(binding)
            require(value.shape == (), "a constraint is not one number")
            cost = float(value.detach())
            require(
                cost >= 0 and cost < float("inf"), f"the penalty on {name} face, rows pushed by {push:g}, is {cost}"
            )
            _require_finite_slopes(value, list(rows.values()))
