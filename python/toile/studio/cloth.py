"""Cloth by newton's vertex block descent, with the moving body as collider. Settings were measured; see each line."""

from __future__ import annotations

import numpy as np

SUBSTEPS = 40  # x 1 iteration: 8 x 8 does not converge (the cloth sags by a fifth)
RADIUS = 0.005  # m: contact distance; 4 mm is the smallest that kept body features from poking through faces
OVER_CLOTH = 0.008  # m: contact distance of what is worn over another garment, whose folds are sharper than the body
GAP = 0.012  # m: contacts are looked for up to the contact distance + GAP
SELF_CONTACT = {  # m: the distance of cloth from cloth, and how much farther off contacts are looked for
    "particle_self_contact_margin": 0.003, "particle_self_contact_gap": 0.0018,
}  # fmt: skip
REACH = 3.0  # m: half the collision box of the body, which newton takes from the first pose


class ClothSimulation:
    """One garment or several (V, F; V is also the rest shape) over moving surfaces [m, s], z up: `body_F` is a list of
    triangles, one array a surface, of vertices body_V. Surfaces are closed, or lie so that the cloth never sees their
    borders. Vertices `held` (h,) go where each frame is told. Cloth that `meets_itself` may not begin crossed."""

    def __init__(self, V, F, body_V, body_F, mu=0.3, held=(), meets_itself=False):
        import newton
        import warp as wp

        wp.config.log_level = wp.LOG_ERROR
        self.wp = wp
        builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
        builder.add_cloth_mesh(
            pos=wp.vec3(0.0, 0.0, 0.0),
            rot=wp.quat_identity(),
            scale=1.0,
            vel=wp.vec3(0.0, 0.0, 0.0),
            vertices=[wp.vec3(*map(float, v)) for v in V],
            indices=np.asarray(F).ravel().tolist(),
            density=0.2,
            tri_ke=500.0,
            tri_ka=500.0,
            tri_kd=1e-3,
            edge_ke=1e-4,
            edge_kd=1e-5,
            particle_radius=RADIUS if len(body_F) == 1 else OVER_CLOTH,
        )
        self.held = np.asarray(held, np.int64)
        for i in self.held:
            builder.particle_mass[i] = 0.0
        cfg = newton.ModelBuilder.ShapeConfig(ke=5e3, kd=1e-2, mu=mu)
        colliders = []
        for faces in body_F:
            faces = np.asarray(faces, np.int32).ravel()
            colliders.append(newton.Mesh(np.asarray(body_V, np.float32), faces, compute_inertia=False))
            builder.add_shape_mesh(body=-1, mesh=colliders[-1], cfg=cfg)
        builder.color()
        with wp.ScopedDevice("cpu"):
            self.model = builder.finalize()
            self.model.soft_contact_ke, self.model.soft_contact_kd, self.model.soft_contact_mu = 5e3, 1e-2, mu
            self.model.shape_collision_aabb_lower.fill_(wp.vec3(-REACH, -REACH, -REACH))
            self.model.shape_collision_aabb_upper.fill_(wp.vec3(REACH, REACH, REACH))
            self.meshes = [collider.mesh for collider in colliders]
            self.pipeline = newton.CollisionPipeline(self.model, soft_contact_gap=GAP)
            self.contacts = self.pipeline.contacts()
            self.solver = newton.solvers.SolverVBD(
                self.model,
                iterations=1,
                integrate_with_external_rigid_solver=True,
                particle_enable_self_contact=meets_itself,
                **(SELF_CONTACT if meets_itself else {}),
            )
            self.state, self.next = self.model.state(), self.model.state()
            self.control = self.model.control()
        self.rest, self.faces = np.asarray(V, np.float64), np.asarray(F, np.int32)
        self.body = self.first_body = np.asarray(body_V, np.float64)

    @property
    def vertices(self):
        return self.state.particle_q.numpy().astype(np.float64)

    @property
    def velocities(self):
        return self.state.particle_qd.numpy().copy()

    def go_on_from(self, vertices, velocities, body):
        """Takes up the state that another simulation of the same first body was left in: goes on to the same bits."""
        self.state.particle_q.assign(np.asarray(vertices, np.float32))
        self.state.particle_qd.assign(np.asarray(velocities, np.float32))
        self.body = np.asarray(body, np.float64)

    def move(self, V):
        """Puts the cloth at V (n,3), at rest."""
        self.state.particle_q.assign(np.asarray(V, np.float32))
        self.state.particle_qd.zero_()

    def set_world(self, gravity, mu):
        """Gravity [m/s2, downwards] and friction from here on."""
        self.model.set_gravity((0.0, 0.0, -float(gravity)))
        self.model.soft_contact_mu = mu
        self.model.shape_material_mu.fill_(mu)

    def frame(self, body_V, held_V=None, fps=30.0, damping=0.0):
        """Advances one frame while the body goes linearly to body_V (n,3) and the held vertices to held_V (h,3) [where
        they are]; gives the cloth's vertices."""
        dt = 1.0 / fps / SUBSTEPS
        start, end = self.body, np.asarray(body_V, np.float64)
        velocity = ((end - start) * fps).astype(np.float32)
        from_V = self.vertices[self.held]
        to_V = from_V if held_V is None else held_V
        with self.wp.ScopedDevice("cpu"):
            for mesh in self.meshes:
                mesh.velocities.assign(velocity)
            for k in range(SUBSTEPS):
                points = (start + (end - start) * ((k + 1) / SUBSTEPS)).astype(np.float32)
                for mesh in self.meshes:
                    mesh.points.assign(points)
                    mesh.refit()
                if len(self.held):
                    V = self.state.particle_q.numpy()
                    V[self.held] = from_V + (to_V - from_V) * ((k + 1) / SUBSTEPS)
                    self.state.particle_q.assign(V)
                self.state.clear_forces()
                self.pipeline.collide(self.state, self.contacts)
                self.solver.step(self.state, self.next, self.control, self.contacts, dt)
                self.state, self.next = self.next, self.state
                if damping:
                    self.state.particle_qd.assign(self.state.particle_qd.numpy() * np.float32(1 - damping))
        self.body = end
        V = self.vertices
        if not np.isfinite(V).all():
            raise FloatingPointError("the cloth simulation left finite numbers")
        return V
