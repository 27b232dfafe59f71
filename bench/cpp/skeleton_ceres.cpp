// The skeleton kernel's least-squares problem for fixed matches, minimised by its own steps and by Ceres: same residuals,
// same analytic derivatives, same robust function, one thread. Built and called by bench/libraries.py.
#include <ceres/ceres.h>
#include <pybind11/eigen.h>
#include <pybind11/pybind11.h>

#include <Eigen/Cholesky>
#include <chrono>
#include <map>
#include <memory>

#include "kernels/skeleton/problem.h"

namespace py = pybind11;
using namespace toile;
using toile::skeleton::Match;
using toile::skeleton::Problem;
using toile::skeleton::ScanSurface;

namespace {

struct Answer {
    BodyState state;
    double energy = 0, seconds = 0;
    int iterations = 0;
};

double seconds_since(std::chrono::steady_clock::time_point start) {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

/// The kernel's own Levenberg-Marquardt steps, until one lowers the energy by less than `tolerance` of it.
Answer by_own_steps(const Problem& problem, BodyState state, double tolerance, int most) {
    const auto start = std::chrono::steady_clock::now();
    Answer a{state, problem.energy(state)};
    double damping = 1e-4;
    for (; a.iterations < most; ++a.iterations) {
        const skeleton::System system = problem.linearise(a.state);
        const double before = system.energy;
        bool accepted = false;
        for (int attempt = 0; attempt < 8 && !accepted; ++attempt) {
            Eigen::MatrixXd A = system.H;
            A.diagonal() *= 1 + damping;
            A.diagonal().array() += 1e-9 * std::max(1.0, system.H.diagonal().maxCoeff());
            const BodyState next = problem.moved(a.state, -Eigen::LLT<Eigen::MatrixXd>(A).solve(system.g));
            const double energy = problem.energy(next);
            accepted = energy <= before;
            damping = accepted ? std::max(damping * 0.2, 1e-7) : std::max(damping * 8, 1e-5);
            if (accepted) a.state = next, a.energy = energy;
        }
        if (!accepted || before - a.energy < tolerance * before) break;
    }
    a.seconds = seconds_since(start);
    return a;
}

/// d exp(u) about exp(u): exp(u + e) = exp(J e) exp(u).
Mat3 left_jacobian(const Vec3& u) {
    const double t = u.norm();
    Mat3 X;
    X << 0, -u.z(), u.y(), u.z(), 0, -u.x(), -u.y(), u.x(), 0;
    if (t < 1e-9) return Mat3::Identity() + 0.5 * X;
    return Mat3::Identity() + (1 - std::cos(t)) / (t * t) * X + (t - std::sin(t)) / (t * t * t) * X * X;
}

/// Unknowns about a base state, and the body that they make; posed once for all residuals.
struct Unknowns : ceres::EvaluationCallback {
    Unknowns(const BodyModel& model, BodyState base)
        : model(model), base(std::move(base)), turn(static_cast<std::size_t>(model.joints()), Vec3::Zero()),
          turned(turn.size(), Mat3::Identity()), move(Vec3::Zero()), shape(Vector::Zero(model.shapes())) {}
    void PrepareForEvaluation(bool jacobians, bool) override {
        BodyState next = state();
        for (std::size_t k = 0; k < turn.size(); ++k) turned[k] = left_jacobian(turn[k]);
        body = std::make_unique<PosedBody>(model, next, jacobians);
    }
    BodyState state() const {
        BodyState next = base;
        for (std::size_t k = 0; k < turn.size(); ++k) next.local[k] = rotation_matrix(turn[k]) * base.local[k];
        next.translation += move;
        next.shape += shape;
        return next;
    }
    const BodyModel& model;
    BodyState base;
    std::vector<Vec3> turn;
    std::vector<Mat3> turned;
    Vec3 move;
    Vector shape;
    std::unique_ptr<PosedBody> body;
};

struct GemanMcClure : ceres::LossFunction {
    GemanMcClure(double scale, double c) : scale(scale), c2(c * c) {}
    void Evaluate(double s, double rho[3]) const override {
        const double w = 1 / (1 + s / c2);
        rho[0] = scale * s * w, rho[1] = scale * w * w, rho[2] = -2 * scale * w * w * w / c2;
    }
    double scale, c2;
};

Eigen::Map<Eigen::RowVectorXd> row(double* values, int size) { return {values, size}; }

/// n . (q - y): blocks are the free joints that move the vertex, the translation, the shape.
struct Surface : ceres::CostFunction {
    Surface(const Unknowns& u, const Match& m, std::vector<int> joints, BodyGradient& gradient)
        : u(u), match(m), joints(std::move(joints)), gradient(gradient) {
        set_num_residuals(1);
        for (std::size_t i = 0; i <= this->joints.size(); ++i) mutable_parameter_block_sizes()->push_back(3);
        if (u.model.shapes()) mutable_parameter_block_sizes()->push_back(u.model.shapes());
    }
    bool Evaluate(double const* const*, double* residuals, double** jacobians) const override {
        residuals[0] = -match.normal.dot(match.point - u.body->vertex(match.vertex));
        if (!jacobians) return true;
        gradient.clear();
        u.body->add_vertex(match.vertex, match.normal, gradient);
        const int K = u.model.joints();
        for (std::size_t i = 0; i < joints.size(); ++i)
            if (jacobians[i])
                row(jacobians[i], 3) = gradient.values.segment<3>(3 * joints[i]).transpose() *
                                       u.turned[static_cast<std::size_t>(joints[i])];
        if (double* j = jacobians[joints.size()]) row(j, 3) = gradient.values.segment<3>(3 * K).transpose();
        if (u.model.shapes())
            if (double* j = jacobians[joints.size() + 1])
                row(j, u.model.shapes()) = gradient.values.tail(u.model.shapes()).transpose();
        return true;
    }
    const Unknowns& u;
    Match match;
    std::vector<int> joints;
    BodyGradient& gradient;  // one thread
};

/// Spread about rest, and the limit beyond the largest angle.
struct Prior : ceres::SizedCostFunction<4, 3> {
    Prior(const Unknowns& u, int joint, double weight, double limit, double limit_weight)
        : u(u), joint(static_cast<std::size_t>(joint)), weight(weight), limit(limit), limit_weight(limit_weight) {}
    bool Evaluate(double const* const*, double* residuals, double** jacobians) const override {
        const Vec3 r = rotation_log(u.body->state().local[joint]);
        const double over = r.norm() - limit;
        Eigen::Map<Vec3> front(residuals);
        front = weight * r;
        residuals[3] = over > 0 ? limit_weight * over : 0;
        if (!jacobians || !jacobians[0]) return true;
        Eigen::Map<Eigen::Matrix<double, 4, 3, Eigen::RowMajor>> J(jacobians[0]);
        J.topRows<3>() = weight * log_jacobian(r) * u.turned[joint];
        J.row(3).setZero();
        if (over > 0) J.row(3) = limit_weight * r.normalized().transpose() * u.turned[joint];
        return true;
    }
    const Unknowns& u;
    std::size_t joint;
    double weight, limit, limit_weight;
};

struct ShapePrior : ceres::CostFunction {
    ShapePrior(const Unknowns& u, double weight) : u(u), weight(weight) {
        set_num_residuals(u.model.shapes());
        mutable_parameter_block_sizes()->push_back(u.model.shapes());
    }
    bool Evaluate(double const* const*, double* residuals, double** jacobians) const override {
        const int S = u.model.shapes();
        Eigen::Map<Vector>(residuals, S) = weight * u.body->state().shape;
        if (jacobians && jacobians[0])
            Eigen::Map<Eigen::MatrixXd>(jacobians[0], S, S) = weight * Eigen::MatrixXd::Identity(S, S);
        return true;
    }
    const Unknowns& u;
    double weight;
};

Answer by_ceres(const BodyModel& model, const Problem& problem, const Vector& sigma, const Vector& limit,
                const Vector& area, const SkeletonOptions& o, const BodyState& start, ceres::LinearSolverType solver,
                double tolerance, int most) {
    const auto begin = std::chrono::steady_clock::now();
    Unknowns u(model, start);
    BodyGradient gradient(model);
    ceres::Problem::Options settings;
    settings.evaluation_callback = &u;
    settings.enable_fast_removal = false;
    settings.disable_all_safety_checks = true;
    ceres::Problem p(settings);
    PosedBody body(model, start, true);
    for (const Match& m : problem.matches) {
        gradient.clear();
        body.add_vertex(m.vertex, m.normal, gradient);
        std::vector<int> joints;
        for (int k : gradient.touched)
            if (sigma[k] > 0) joints.push_back(k);
        std::vector<double*> blocks;
        for (int k : joints) blocks.push_back(u.turn[static_cast<std::size_t>(k)].data());
        blocks.push_back(u.move.data());
        if (model.shapes()) blocks.push_back(u.shape.data());
        const double scale = o.surface_weight * area[m.vertex] / (o.surface_sigma * o.surface_sigma);
        p.AddResidualBlock(new Surface(u, m, joints, gradient), new GemanMcClure(scale, problem.surface_robust),
                           blocks);
    }
    for (int k = 0; k < model.joints(); ++k)
        if (sigma[k] > 0) {
            const double weight = std::isfinite(sigma[k]) ? std::sqrt(o.pose_weight) / sigma[k] : 0;
            p.AddResidualBlock(new Prior(u, k, weight, std::min(limit[k], 1e9), 1 / o.limit_sigma), nullptr,
                               u.turn[static_cast<std::size_t>(k)].data());
        }
    if (model.shapes()) p.AddResidualBlock(new ShapePrior(u, std::sqrt(o.shape_weight)), nullptr, u.shape.data());
    ceres::Solver::Options options;
    options.linear_solver_type = solver;
    options.num_threads = 1;
    options.initial_trust_region_radius = 1e4;
    options.function_tolerance = tolerance;
    options.gradient_tolerance = 0;
    options.parameter_tolerance = 0;
    options.max_num_iterations = most;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &p, &summary);
    Answer a{u.state(), 2 * summary.final_cost};
    a.iterations = static_cast<int>(summary.iterations.size()) - 1;
    a.seconds = seconds_since(begin);
    return a;
}

py::list compare(const BodyModel& model, const Vector& sigma, const Vector& limit, const Vertices& scan_V,
                 const Faces& scan_F, const Vertices& rotations, const Vec3& translation, const Vector& shape,
                 double reach, double tolerance, int most) {
    SkeletonOptions o;
    SkeletonFrame frame;
    frame.scan_V = scan_V;
    frame.scan_F = scan_F;
    BodyState start{rotation_matrices(rotations), translation, shape};
    std::vector<int> seen;
    for (int v = 0; v < model.v_template.rows(); v += 2) seen.push_back(v);
    const Indices samples = Eigen::Map<const Indices>(seen.data(), static_cast<Eigen::Index>(seen.size()));
    const Vector mass = voronoi_mass(model.v_template, model.F);
    const Vector area = mass / mass(samples).sum();
    Problem problem(model, sigma, limit, area, frame, o, true);
    problem.surface_robust = o.surface_robust;
    problem.keypoint_robust = o.keypoint_robust_sigmas;
    const Vertices Y = problem.posed(start).vertices();
    problem.matches = ScanSurface(scan_V, scan_F).match(Y, vertex_normals(Y, model.F), samples, reach, o.min_cosine);
    py::list out;
    const auto add = [&](const char* name, const Answer& a) {
        out.append(py::make_tuple(name, a.seconds, problem.energy(a.state), a.iterations, problem.matches.size(),
                                  problem.unknowns()));
    };
    add("own", by_own_steps(problem, start, tolerance, most));
    add("ceres dense_normal_cholesky",
        by_ceres(model, problem, sigma, limit, area, o, start, ceres::DENSE_NORMAL_CHOLESKY, tolerance, most));
    add("ceres dense_qr", by_ceres(model, problem, sigma, limit, area, o, start, ceres::DENSE_QR, tolerance, most));
    add("ceres sparse_normal_cholesky",
        by_ceres(model, problem, sigma, limit, area, o, start, ceres::SPARSE_NORMAL_CHOLESKY, tolerance, most));
    return out;
}

}  // namespace

PYBIND11_MODULE(skeleton_ceres, m) {
    py::module_::import("toile._core");  // whose BodyModel is taken
    m.def("compare", &compare);
}
