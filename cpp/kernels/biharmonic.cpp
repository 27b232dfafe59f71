#include "kernels/biharmonic.h"

#include <cmath>
#include <cstdio>
#include <limits>

#include "base/errors.h"
#include "geometry/intrinsic.h"
#include "geometry/laplacian.h"
#include "geometry/topology.h"

namespace toile {

namespace {

/// Faces of three different vertices; the others have neither area nor angles, mollified or not.
Faces proper_faces(const Faces& F) {
    Faces kept(F.rows(), 3);
    Eigen::Index count = 0;
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        if (F(f, 0) != F(f, 1) && F(f, 1) != F(f, 2) && F(f, 2) != F(f, 0)) kept.row(count++) = F.row(f);
    return kept.topRows(count);
}

void check_known(const Indices& known, Eigen::Index n) {
    require(known.size() > 0, "biharmonic: known is empty");
    check_indices("biharmonic", "known", known, n);
    std::vector<Eigen::Index> first(static_cast<std::size_t>(n), -1);
    for (Eigen::Index k = 0; k < known.size(); ++k) {
        auto& seen = first[static_cast<std::size_t>(known[k])];
        require(seen < 0, "biharmonic: known[" + std::to_string(k) + "] repeats vertex " + std::to_string(known[k]) +
                              " of known[" + std::to_string(seen) + "]");
        seen = k;
    }
}

/// Every component that has a face needs a known vertex: without one its displacement is not determined.
void check_components(const Faces& F, const Indices& known, Eigen::Index n) {
    const Indices component = vertex_components(F, n);
    std::vector<char> anchored(static_cast<std::size_t>(component.maxCoeff()) + 1, 0);
    for (const int v : known) anchored[static_cast<std::size_t>(component[v])] = 1;
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        const int c = component[F(f, 0)];
        if (anchored[static_cast<std::size_t>(c)]) continue;
        throw InputError("biharmonic: known has no vertex in component " + std::to_string(c) + " (" +
                         std::to_string((component.array() == c).count()) + " vertices, face " + std::to_string(f) +
                         " at vertex " + std::to_string(F(f, 0)) + ")");
    }
}

Sparse columns(const Sparse& A, const std::vector<int>& chosen) {
    Sparse selection(A.cols(), static_cast<Eigen::Index>(chosen.size()));
    selection.reserve(Eigen::VectorXi::Ones(selection.cols()));
    for (std::size_t k = 0; k < chosen.size(); ++k) selection.insert(chosen[k], static_cast<Eigen::Index>(k)) = 1;
    return A * selection;
}

std::string scientific(double value) {
    char text[32];
    std::snprintf(text, sizeof text, "%.1e", value);
    return text;
}

}  // namespace

BiharmonicSolver::BiharmonicSolver(const Vertices& V, const Faces& F_all, const Indices& known,
                                   const BiharmonicOptions& options)
    : options_(options), n_(V.rows()), known_(known.begin(), known.end()) {
    require(options.accuracy > 0, "biharmonic: accuracy is " + scientific(options.accuracy) + ", expected more than 0");
    require(options.refinements >= 0, "biharmonic: refinements is negative");
    check_mesh("biharmonic", V, F_all);
    check_known(known, V.rows());
    const Faces F = proper_faces(F_all);
    require(F.rows() > 0, "biharmonic: F has no face of three different vertices");
    check_components(F, known, V.rows());

    std::vector<char> free(static_cast<std::size_t>(V.rows()), 0);
    for (Eigen::Index k = 0; k < F.size(); ++k) free[static_cast<std::size_t>(F.data()[k])] = 1;
    for (const int v : known_) free[static_cast<std::size_t>(v)] = 0;
    for (Eigen::Index v = 0; v < V.rows(); ++v)
        if (free[static_cast<std::size_t>(v)]) unknown_.push_back(static_cast<int>(v));
    if (unknown_.empty()) return;

    // A face of no area would only drop out of L and leave a slit; mollified it holds its corners together.
    if (face_areas(V, F).minCoeff() > 0 && factorize(cotangent_laplacian(V, F), voronoi_mass(V, F))) return;
    const Vertices lengths = edge_lengths(V, F);
    const double mean = lengths.mean();
    require(mean > 0 && std::isfinite(mean), "biharmonic: all faces of F have their corners in one point of V");
    for (const double margin : {1e-6, 1e-5, 1e-4, 1e-3, 1e-2}) {
        Vertices mollified = lengths;
        mollified_ = mollify(mollified, margin * mean);
        if (factorize(intrinsic_laplacian(mollified, F, V.rows()), intrinsic_voronoi_mass(mollified, F, V.rows())))
            return;
    }
    throw SolveError("biharmonic: the factor misses the constant field by " + scientific(factor_error_) +
                     " even with edges mollified by " + scientific(mollified_) + " m");
}

/// True when LL' exists and reproduces the constant field.
bool BiharmonicSolver::factorize(const Sparse& L, const Vector& mass) {
    L_ = L;
    inverse_mass_ = mass.cwiseInverse();
    factor_error_ = std::numeric_limits<double>::infinity();
    for (Eigen::Index v = 0; v < mass.size(); ++v)
        if (mass[v] == 0) inverse_mass_[v] = 0;
    for (const int v : unknown_)
        if (!(mass[v] > 0) || !std::isfinite(inverse_mass_[v])) return false;
    const Sparse L_u = columns(L, unknown_);
    const Sparse Q_uu = Sparse(L_u.transpose()) * inverse_mass_.asDiagonal() * L_u;  // (L M^-1 L)_uu
    factor_.analyze(Q_uu);
    if (!factor_.try_factorize(Q_uu)) return false;
    Vertices ones = Vertices::Zero(n_, 3);
    for (const int v : known_) ones.row(v).setOnes();
    settle(ones);
    factor_error_ = 0;
    for (const int v : unknown_)
        for (int c = 0; c < 3; ++c)
            if (const double e = std::abs(ones(v, c) - 1); !(e <= factor_error_)) factor_error_ = e;
    return factor_error_ <= options_.accuracy;
}

/// Solves for the unknown rows of D, from what they hold: D_u += Q_uu^-1 r, r = -(L M^-1 L D)_u, while that shrinks.
/// Returns the last correction relative to the largest displacement.
double BiharmonicSolver::settle(Vertices& D) const {
    const auto u = static_cast<Eigen::Index>(unknown_.size());
    double last = std::numeric_limits<double>::infinity();
    for (int step = 0; step <= options_.refinements; ++step) {
        const Eigen::MatrixXd curvature = inverse_mass_.asDiagonal() * Eigen::MatrixXd(L_ * D);
        const Eigen::MatrixXd gradient = L_ * curvature;
        Matrix residual(u, 3);
        for (Eigen::Index k = 0; k < u; ++k) residual.row(k) = -gradient.row(unknown_[static_cast<std::size_t>(k)]);
        const Matrix correction = factor_.solve(residual);
        const double size = correction.cwiseAbs().maxCoeff();
        if (step > 1 && !(size < last)) break;  // at the floor of rounding
        for (Eigen::Index k = 0; k < u; ++k) D.row(unknown_[static_cast<std::size_t>(k)]) += correction.row(k);
        last = size;
        if (size <= 1e-15 * D.cwiseAbs().maxCoeff()) break;
    }
    const double largest = D.cwiseAbs().maxCoeff();
    return largest > 0 ? last / largest : 0;
}

Vertices BiharmonicSolver::solve(const Vertices& D_known) const {
    require(D_known.rows() == static_cast<Eigen::Index>(known_.size()),
            "biharmonic: D_known has " + std::to_string(D_known.rows()) + " rows, known has " +
                std::to_string(known_.size()));
    check_finite("biharmonic", "D_known", D_known);
    const Eigen::RowVector3d offset = D_known.row(0);  // taken off first, so that translations are exact
    Vertices D = Vertices::Zero(n_, 3);
    for (std::size_t k = 0; k < known_.size(); ++k)
        D.row(known_[k]) = D_known.row(static_cast<Eigen::Index>(k)) - offset;
    if (!unknown_.empty()) {
        const double error = settle(D);
        if (options_.refinements > 0 && !(error <= options_.accuracy))
            throw SolveError("biharmonic: refinement stalls at a relative correction of " + scientific(error));
        for (const int v : unknown_) D.row(v) += offset;
    }
    for (std::size_t k = 0; k < known_.size(); ++k) D.row(known_[k]) = D_known.row(static_cast<Eigen::Index>(k));
    return D;
}

Vertices biharmonic(const Vertices& V, const Faces& F, const Indices& known, const Vertices& D_known,
                    const BiharmonicOptions& options) {
    return BiharmonicSolver(V, F, known, options).solve(D_known);
}

}  // namespace toile
