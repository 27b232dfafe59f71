// One frame's least-squares problem of the skeleton kernel: matches to the scan, residuals and their derivatives.
#pragma once
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include "base/parallel.h"
#include "geometry/closest.h"
#include "geometry/confidence.h"
#include "geometry/laplacian.h"
#include "geometry/weld.h"
#include "kernels/skeleton.h"

namespace toile::skeleton {

using Eigen::MatrixXd;

/// Normal equations H x = -g of one linearisation; Sum of a parallel_sum.
struct System {
    MatrixXd H;  // lower triangle
    Vector g;
    double energy = 0;
    std::int64_t matched = 0;
    double squares = 0;  // of matched distances [m^2]
    System& operator+=(const System& o) {
        H += o.H;
        g += o.g;
        energy += o.energy;
        matched += o.matched;
        squares += o.squares;
        return *this;
    }
};

struct Match {
    int vertex;
    Vec3 point, normal;
    double confidence = 1;  ///< of the scan there
};

/// Geman-McClure r^2 / (1 + r^2 / c^2): value, and weight of r^2 in a reweighted step.
inline double robust_value(double r2, double c) { return r2 / (1 + r2 / (c * c)); }
inline double robust_weight(double r2, double c) { return 1 / ((1 + r2 / (c * c)) * (1 + r2 / (c * c))); }

/// Unit normals (n,3) at the vertices `at`, the bits of `vertex_normals`, and zero at the others; `faces_of` each vertex.
inline Vertices sample_normals(const Vertices& V, const Faces& F, const Adjacency& faces_of, const Indices& at) {
    constexpr double cancelled = 1e-12;  // a share of the faces' area that rounding leaves where they face each other
    Vertices N = Vertices::Zero(V.rows(), 3);
    parallel_for(at.size(), [&](std::int64_t i) {
        const int v = at[i];
        Vec3 sum = Vec3::Zero();
        double area = 0;
        for (int k = faces_of.start[v]; k < faces_of.start[v + 1]; ++k) {
            const auto face = F.row(faces_of.index[k]);
            const Vec3 a = V.row(face[0]), b = V.row(face[1]), c = V.row(face[2]), n = (b - a).cross(c - a);
            for (int corner = 0; corner < 3; ++corner)
                if (face[corner] == v) sum += n, area += n.norm();
        }
        if (const double length = sum.norm(); length > cancelled * area) N.row(v) = (sum / length).transpose();
    });
    return N;
}

class ScanSurface {
public:
    explicit ScanSurface(const SkeletonFrame& frame)
        : index_(index_of(frame)), normals_(vertex_normals(index_->vertices(), index_->faces())),
          confidence_(frame.scan_confidence.size() ? frame.scan_confidence : Vector::Ones(frame.scan_V.rows())) {}

    /// Matches of samples within `reach` whose normals agree up to the scan's orientation, in order of the samples.
    /// `face`: the faces found for the samples, -1 for none; those of a pose before save time and change nothing.
    std::vector<Match> match(const Vertices& Y, const Vertices& model_normals, const Indices& samples, double reach,
                             double min_cosine, std::vector<int>& face) const {
        face.resize(static_cast<std::size_t>(samples.size()), -1);
        std::vector<Match> all(static_cast<std::size_t>(samples.size()));
        std::vector<double> cosine(all.size(), 0);
        parallel_for(samples.size(), [&](std::int64_t i) {
            const auto s = static_cast<std::size_t>(i);
            const int v = samples[i];
            const SurfacePoint hit = index_->closest(Vec3(Y.row(v)), reach, face[s]);
            face[s] = hit.face;
            all[s].vertex = hit.face < 0 ? -1 : v;
            if (hit.face < 0) return;
            Vec3 n = Vec3::Zero();
            for (int c = 0; c < 3; ++c)
                n += hit.barycentric[c] * normals_.row(index_->faces()(hit.face, c)).transpose();
            all[s].point = hit.point;
            all[s].normal = n.normalized();
            all[s].confidence = confidence_at(confidence_, index_->faces().row(hit.face), hit.barycentric);
            cosine[s] = all[s].normal.dot(model_normals.row(v));
            const double along = std::abs(all[s].normal.dot(Vec3(Y.row(v)) - hit.point));
            if (hit.distance > 0.005 && along < 0.5 * hit.distance) all[s].vertex = -1;  // beyond the border of a hole
        });
        double vote = 0;
        for (double c : cosine) vote += c;
        const double side = vote < 0 ? -1 : 1;  // a scan whose faces all look inwards
        std::vector<Match> kept;
        for (std::size_t s = 0; s < all.size(); ++s) {
            if (all[s].vertex < 0 || !(side * cosine[s] > min_cosine)) continue;
            all[s].normal *= side;
            kept.push_back(all[s]);
        }
        return kept;
    }

private:
    /// The frame's own where it is of the same faces, each once.
    static std::shared_ptr<const SurfaceIndex> index_of(const SkeletonFrame& frame) {
        const Faces F = distinct_faces(frame.scan_F, frame.scan_V.rows());
        const auto& own = frame.scan_index;
        const bool same = own && own->vertices().rows() == frame.scan_V.rows() && own->faces().rows() == F.rows() &&
                          own->faces() == F && own->vertices() == frame.scan_V;
        return same ? own : std::make_shared<const SurfaceIndex>(frame.scan_V, F);
    }

    std::shared_ptr<const SurfaceIndex> index_;
    Vertices normals_;
    Vector confidence_;
};

/// One frame's problem: knows which unknowns are free and how to linearise.
class Problem {
public:
    Problem(const BodyModel& model, const Vector& joint_sigma, const Vector& joint_limit, const Vertices& twist,
            const Vector& area, const SkeletonFrame& frame, const SkeletonOptions& o, bool free_shape)
        : model_(model), sigma_(joint_sigma), limit_(joint_limit), twist_(twist), area_(area), frame_(frame), o_(o),
          free_shape_(free_shape) {
        column_.assign(static_cast<std::size_t>(model.joints()), -1);
        for (int k = 0; k < model.joints(); ++k)
            if (sigma_[k] > 0) {
                column_[static_cast<std::size_t>(k)] = unknowns_;
                unknowns_ += 3;
            }
        translation_ = unknowns_;
        unknowns_ += 3 + (free_shape ? model.shapes() : 0);
        predict();
    }

    int unknowns() const { return unknowns_; }
    int shape_start() const { return translation_ + 3; }
    double keypoint_robust = 0, surface_robust = 0;
    std::vector<Match> matches;

    /// Shapes seldom change from one step to the next.
    PosedBody posed(const BodyState& state, bool shape_derivatives = false) const {
        if (!shaped_ || shaped_->shape != state.shape) shaped_ = std::make_shared<ShapedBody>(model_, state.shape);
        return {model_, shaped_, state, shape_derivatives};
    }

    double energy(const BodyState& state) const {
        const PosedBody body = posed(state);
        double e =
            parallel_sum<double>(static_cast<std::int64_t>(matches.size()), 0.0, [&](double& sum, std::int64_t i) {
            const Match& m = matches[static_cast<std::size_t>(i)];
            const double d = m.normal.dot(m.point - body.vertex(m.vertex));
            sum += surface_scale(m, d) * robust_value(d * d, surface_robust);
        });
        for (Eigen::Index i = 0; i < frame_.keypoints.index.size(); ++i)
            e += robust_value(keypoint_residual(body, i).squaredNorm(), keypoint_robust);
        System unused;
        add_priors(state, unused, false);
        return e + unused.energy;
    }

    System linearise(const BodyState& state) const {
        const PosedBody body = posed(state, free_shape_);
        System zero;
        zero.H = MatrixXd::Zero(unknowns_, unknowns_);
        zero.g = Vector::Zero(unknowns_);
        const auto count = static_cast<std::int64_t>(matches.size());
        const std::int64_t blocks = (count + kBlock - 1) / kBlock;
        System system = parallel_sum<System>(blocks, zero, [&](System& sum, std::int64_t b) {
            BodyGradient gradient(model_);
            for (std::int64_t i = b * kBlock, end = std::min(count, i + kBlock); i < end; ++i)
                add_match(body, matches[static_cast<std::size_t>(i)], gradient, sum);
        }, 1);
        BodyGradient gradient(model_);
        for (Eigen::Index i = 0; i < frame_.keypoints.index.size(); ++i) add_keypoint(body, i, gradient, system);
        add_priors(state, system, true);
        return system;
    }

    /// The state moved by x; x orders unknowns as linearise does.
    BodyState moved(const BodyState& state, const Vector& x) const {
        BodyState next = state;
        for (std::size_t k = 0; k < column_.size(); ++k)
            if (column_[k] >= 0) next.local[k] = rotation_matrix(x.segment<3>(column_[k])) * state.local[k];
        next.translation += x.segment<3>(translation_);
        if (free_shape_) next.shape += x.tail(model_.shapes());
        return next;
    }

    double keypoint_rms(const PosedBody& body) const {
        const Eigen::Index n = frame_.keypoints.index.size();
        double sum = 0;
        for (Eigen::Index i = 0; i < n; ++i) sum += (keypoint_sigma(i) * keypoint_residual(body, i)).squaredNorm();
        return n ? std::sqrt(sum / static_cast<double>(n)) : 0;
    }

private:
    static constexpr std::int64_t kBlock = 1024;  // matches whose equations one matrix gathers
    const BodyModel& model_;
    const Vector& sigma_;
    const Vector& limit_;
    const Vertices& twist_;
    const Vector& area_;
    const SkeletonFrame& frame_;
    const SkeletonOptions& o_;
    bool free_shape_;
    std::vector<int> column_;
    int unknowns_ = 0, translation_ = 0;
    BodyState predicted_;                               // empty without earlier frames
    mutable std::shared_ptr<const ShapedBody> shaped_;  // of the last state

    void predict() {
        if (frame_.previous.empty()) return;
        const SkeletonPose& one = frame_.previous[0];
        predicted_.local = rotation_matrices(one.rotations);
        predicted_.translation = one.translation;
        if (frame_.previous.size() < 2) return;
        const std::vector<Mat3> two = rotation_matrices(frame_.previous[1].rotations);
        for (std::size_t k = 0; k < two.size(); ++k)
            predicted_.local[k] = predicted_.local[k] * two[k].transpose() * predicted_.local[k];
        predicted_.translation = 2 * one.translation - frame_.previous[1].translation;
    }

    /// Weight of one squared distance [1/m^2]; d > 0: the scan lies outside the model.
    double surface_scale(const Match& m, double d) const {
        double w = o_.surface_weight * area_[m.vertex] / (o_.surface_sigma * o_.surface_sigma) * m.confidence;
        if (frame_.clothed.size() && d > 0) w *= 1 + frame_.clothed[m.vertex] * (o_.cloth_fit - 1);
        return w;
    }

    void add_match(const PosedBody& body, const Match& m, BodyGradient& gradient, System& sum) const {
        const double d = m.normal.dot(m.point - body.vertex(m.vertex)), scale = surface_scale(m, d);
        gradient.clear();
        body.add_vertex(m.vertex, m.normal, gradient);
        add_row(gradient, -d, scale * robust_weight(d * d, surface_robust), sum);
        sum.energy += scale * robust_value(d * d, surface_robust);
        ++sum.matched;
        sum.squares += d * d;
    }

    /// No keypoint is exact to less: a smaller sigma would make each an outlier of the first guess.
    double keypoint_sigma(Eigen::Index i) const { return std::max(frame_.keypoints.sigma[i], 1e-3); }

    /// (k_i - p_i) / sigma_i.
    Vec3 keypoint_residual(const PosedBody& body, Eigen::Index i) const {
        const BodyKeypoint& k = model_.keypoints[static_cast<std::size_t>(frame_.keypoints.index[i])];
        Vec3 y = Vec3::Zero();
        if (k.joint >= 0)
            y = body.joint(k.joint);
        else
            for (std::size_t j = 0; j < k.vertices.size(); ++j) y += k.weights[j] * body.vertex(k.vertices[j]);
        return (y - frame_.keypoints.points.row(i).transpose()) / keypoint_sigma(i);
    }

    void add_keypoint(const PosedBody& body, Eigen::Index i, BodyGradient& gradient, System& sum) const {
        const BodyKeypoint& k = model_.keypoints[static_cast<std::size_t>(frame_.keypoints.index[i])];
        const Vec3 r = keypoint_residual(body, i);
        const double w = robust_weight(r.squaredNorm(), keypoint_robust);
        sum.energy += robust_value(r.squaredNorm(), keypoint_robust);
        for (int c = 0; c < 3; ++c) {
            const Vec3 direction = Vec3::Unit(c) / keypoint_sigma(i);
            gradient.clear();
            if (k.joint >= 0)
                body.add_joint(k.joint, direction, gradient);
            else
                for (std::size_t j = 0; j < k.vertices.size(); ++j)
                    body.add_vertex(k.vertices[j], k.weights[j] * direction, gradient);
            add_row(gradient, r[c], w, sum);
        }
    }

    /// w r^2 with r ~ r + gradient . x.
    void add_row(const BodyGradient& gradient, double r, double w, System& sum) const {
        std::vector<std::pair<int, const double*>> joints;  // unknowns in threes, ascending
        joints.reserve(gradient.touched.size());
        for (int k : gradient.touched)
            if (const int c = column_[static_cast<std::size_t>(k)]; c >= 0)
                joints.emplace_back(c, gradient.values.data() + 3 * k);
        std::sort(joints.begin(), joints.end());
        const int tail = free_shape_ ? 3 + model_.shapes() : 3;
        const auto last = gradient.values.segment(3 * model_.joints(), tail);
        for (std::size_t a = 0; a < joints.size(); ++a)
            for (int i = 0; i < 3; ++i) {
                const auto [c, values] = joints[a];
                const double wa = w * values[i];
                sum.g[c + i] += wa * r;
                double* column = sum.H.data() + static_cast<std::ptrdiff_t>(c + i) * unknowns_;
                for (int j = i; j < 3; ++j) column[c + j] += wa * values[j];
                for (std::size_t b = a + 1; b < joints.size(); ++b)
                    for (int j = 0; j < 3; ++j) column[joints[b].first + j] += wa * joints[b].second[j];
                Eigen::Map<Vector>(column + translation_, tail) += wa * last;
            }
        for (int i = 0; i < tail; ++i) {
            const double wa = w * last[i];
            sum.g[translation_ + i] += wa * r;
            sum.H.col(translation_ + i).segment(translation_ + i, tail - i) += wa * last.tail(tail - i);
        }
    }

    void add_block(int column, const Mat3& J, const Vec3& r, double w, System& s, bool derivatives) const {
        s.energy += w * r.squaredNorm();
        if (!derivatives) return;
        s.H.block<3, 3>(column, column) += w * J.transpose() * J;
        s.g.segment<3>(column) += w * J.transpose() * r;
    }

    /// w r^2 of a number r of one joint, with r ~ r + row . x there.
    void add_part(int column, const Vec3& row, double r, double w, System& s, bool derivatives) const {
        s.energy += w * r * r;
        if (!derivatives) return;
        s.H.block<3, 3>(column, column) += w * row * row.transpose();
        s.g.segment<3>(column) += w * r * row;
    }

    void add_priors(const BodyState& state, System& s, bool derivatives) const {
        const double temporal = 1 / (o_.temporal_sigma * o_.temporal_sigma);
        for (int k = 0; k < model_.joints(); ++k) {
            const auto i = static_cast<std::size_t>(k);
            if (column_[i] < 0) continue;
            const Vec3 r = rotation_log(state.local[i]);
            if (std::isfinite(sigma_[k]))
                add_block(column_[i], log_jacobian(r), r, o_.pose_weight / (sigma_[k] * sigma_[k]), s, derivatives);
            if (const Vec3 bone = twist_.row(k); !bone.isZero())
                add_part(column_[i], log_jacobian(r).transpose() * bone, bone.dot(r), o_.pose_weight, s, derivatives);
            if (const double over = r.norm() - limit_[k]; over > 0)  // d |r| / du = r / |r|: log_jacobian leaves r be
                add_part(column_[i], r.normalized(), over, 1 / (o_.limit_sigma * o_.limit_sigma), s, derivatives);
            if (!predicted_.local.empty()) {
                const Vec3 e = rotation_log(state.local[i] * predicted_.local[i].transpose());
                add_block(column_[i], log_jacobian(e), e, temporal, s, derivatives);
            }
        }
        if (!predicted_.local.empty())
            add_block(translation_, Mat3::Identity(), state.translation - predicted_.translation,
                      1 / (o_.temporal_translation * o_.temporal_translation), s, derivatives);
        s.energy += o_.shape_weight * state.shape.squaredNorm();
        if (!derivatives || !free_shape_) return;
        s.g.tail(model_.shapes()) += o_.shape_weight * state.shape;
        s.H.diagonal().tail(model_.shapes()).array() += o_.shape_weight;
    }
};

}  // namespace toile::skeleton
