"""The table of built-in components: slot -> name -> "module:ConfigClass".

A table and not entry points, because an editable install sees a new entry point only after it is installed again.
"""

BUILTIN: dict[str, dict[str, str]] = {
    "field": {
        "mlp": "sculpt_plugins.fields.mlp.config:MlpFieldConfig",
        "hash-grid": "sculpt_plugins.fields.hash_grid.config:HashGridFieldConfig",
        "dense-grid": "sculpt_plugins.fields.dense_grid.config:DenseGridFieldConfig",
    },
    "extractor": {
        "flexicubes": "sculpt_plugins.extractors.flexicubes.config:FlexiCubesConfig",
        "marching-tetrahedra": "sculpt_plugins.extractors.marching_tetrahedra.config:MarchingTetrahedraConfig",
    },
    "binder": {
        "face-barycentric": "sculpt_plugins.binders.face_barycentric.config:FaceBarycentricConfig",
    },
    "appearance": {
        "per-gaussian": "sculpt_plugins.appearances.per_gaussian.config:PerGaussianConfig",
        "color-field": "sculpt_plugins.appearances.color_field.config:ColorFieldConfig",
    },
    "rasterizer": {
        "auto": "sculpt_plugins.rasterizers.auto.config:AutoRasterizerConfig",
        "reference": "sculpt_plugins.rasterizers.reference.config:ReferenceRasterizerConfig",
        "numba": "sculpt_plugins.rasterizers.numba.config:NumbaRasterizerConfig",
        "triton": "sculpt_plugins.rasterizers.triton.config:TritonRasterizerConfig",
        "gsplat": "sculpt_plugins.rasterizers.gsplat.config:GsplatRasterizerConfig",
    },
    "background": {
        "none": "sculpt_framework.config:NoBackgroundConfig",
        "gaussians": "sculpt_plugins.backgrounds.gaussians.config:GaussiansBackgroundConfig",
    },
    "losses": {
        "bending": "sculpt_plugins.losses.bending.config:BendingConfig",
        "consistency": "sculpt_plugins.losses.consistency.config:ConsistencyConfig",
        "photometric": "sculpt_plugins.losses.photometric.config:PhotometricConfig",
        "silhouette": "sculpt_plugins.losses.silhouette.config:SilhouetteConfig",
        "eikonal": "sculpt_plugins.losses.eikonal.config:EikonalConfig",
        "sign-change": "sculpt_plugins.losses.sign_change.config:SignChangeConfig",
        "deviation": "sculpt_plugins.losses.deviation.config:DeviationConfig",
        "cube-weights": "sculpt_plugins.losses.cube_weights.config:CubeWeightsConfig",
    },
    "constraints": {
        "mee-scale": "sculpt_plugins.constraints.mee_scale.config:MeeScaleConfig",
        "boundary": "sculpt_plugins.constraints.boundary.config:BoundaryConfig",
        "spacing": "sculpt_plugins.constraints.spacing.config:SpacingConfig",
        "coverage": "sculpt_plugins.constraints.coverage.config:CoverageConfig",
    },
    "initializer": {
        "photo-hull": "sculpt_plugins.initializers.photo_hull.config:PhotoHullConfig",
        "stereo": "sculpt_plugins.initializers.stereo.config:StereoConfig",
        "sphere": "sculpt_plugins.initializers.sphere.config:SphereConfig",
        "visual-hull": "sculpt_plugins.initializers.visual_hull.config:VisualHullConfig",
        "volume-rendering": "sculpt_plugins.initializers.volume_rendering.config:VolumeRenderingConfig",
    },
    "dataset": {
        "auto": "sculpt_plugins.datasets.auto.config:AutoDatasetConfig",
        "blender": "sculpt_plugins.datasets.blender.config:BlenderConfig",
        "colmap": "sculpt_plugins.datasets.colmap.config:ColmapConfig",
        "demo": "sculpt_plugins.datasets.demo.config:DemoConfig",
        "idr": "sculpt_plugins.datasets.idr.config:IdrConfig",
        "nerfstudio": "sculpt_plugins.datasets.nerfstudio.config:NerfstudioConfig",
        "omniobject3d": "sculpt_plugins.datasets.omniobject3d.config:OmniObject3DConfig",
    },
    "observers": {
        "console": "sculpt_plugins.observers.console.config:ConsoleConfig",
        "recorder": "sculpt_plugins.observers.recorder.config:RecorderConfig",
        "viser": "sculpt_plugins.observers.viser.config:ViserConfig",
    },
}

METHODS: dict[str, str] = {
    "gaussian-sculpting": "sculpt_methods.sculpting:gaussian_sculpting",
    "gaussian-sculpting-fine": "sculpt_methods.sculpting:gaussian_sculpting_fine",
    "gaussian-sculpting-everything": "sculpt_methods.everything:gaussian_sculpting_everything",
    "gaussian-sculpting-paper": "sculpt_methods.paper:gaussian_sculpting_paper",
    "gaussian-sculpting-tiny": "sculpt_methods.sculpting:gaussian_sculpting_tiny",
    "3dgsr": "sculpt_methods.guided:gaussians_3dgsr",
    "3dgsr-paper": "sculpt_methods.paper_sizes:gaussians_3dgsr_paper",
    "gof": "sculpt_methods.splatting:gof",
    "gof-paper": "sculpt_methods.paper_sizes:gof_paper",
    "gsdf": "sculpt_methods.guided:gsdf",
    "gsdf-paper": "sculpt_methods.paper_sizes:gsdf_paper",
    "nerf": "sculpt_methods.volume_rendered:nerf",
    "nerf-paper": "sculpt_methods.paper_sizes:nerf_paper",
    "neus": "sculpt_methods.volume_rendered:neus",
    "neus-paper": "sculpt_methods.paper_sizes:neus_paper",
    "pgsr": "sculpt_methods.splatting:pgsr",
    "pgsr-paper": "sculpt_methods.paper_sizes:pgsr_paper",
    "relightable": "sculpt_methods.splatting:relightable",
    "relightable-paper": "sculpt_methods.paper_sizes:relightable_paper",
    "splatting-2d": "sculpt_methods.splatting:splatting_2d",
    "splatting-2d-paper": "sculpt_methods.paper_sizes:splatting_2d_paper",
    "splatting-3d": "sculpt_methods.splatting:splatting_3d",
    "splatting-3d-paper": "sculpt_methods.paper_sizes:splatting_3d_paper",
    "sugar": "sculpt_methods.splatting:sugar",
    "sugar-paper": "sculpt_methods.paper_sizes:sugar_paper",
    "volsdf": "sculpt_methods.volume_rendered:volsdf",
    "volsdf-paper": "sculpt_methods.paper_sizes:volsdf_paper",
}

EXPORTERS: dict[str, str] = {
    "ply": "sculpt_plugins.exporters.ply.config:PlyExporterConfig",
    "obj": "sculpt_plugins.exporters.obj.config:ObjExporterConfig",
    "glb": "sculpt_plugins.exporters.glb.config:GlbExporterConfig",
    "stl": "sculpt_plugins.exporters.stl.config:StlExporterConfig",
    "3mf": "sculpt_plugins.exporters.three_mf.config:ThreeMfExporterConfig",
    "gaussians": "sculpt_plugins.exporters.gaussians.config:GaussiansExporterConfig",
    "turntable": "sculpt_plugins.exporters.turntable.config:TurntableExporterConfig",
    "maps": "sculpt_plugins.exporters.maps.config:MapsExporterConfig",
    "html": "sculpt_plugins.exporters.html.config:HtmlExporterConfig",
}
