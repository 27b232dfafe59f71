// register_mesh TEMPLATE SCAN OUT [draft|standard|fine]: bends a template mesh onto a scan and writes it as OBJ.
//
// Both files are OBJ, PLY, OFF or STL in one unit and one frame. The output has the template's vertices, in its order, at
// new places, and its faces, cut into triangles.
#include <CGAL/IO/polygon_soup_io.h>
#include <CGAL/Simple_cartesian.h>
#include <toile/base/errors.h>
#include <toile/geometry/closest.h>
#include <toile/kernels/nricp.h>

#include <cstdio>
#include <exception>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

namespace {

using Point = CGAL::Simple_cartesian<double>::Point_3;
using Polygons = std::vector<std::vector<std::size_t>>;

struct Mesh {
    toile::Vertices V;
    toile::Faces F;
};

/// Polygons become fans of triangles about their first corner.
Mesh triangles(const std::vector<Point>& points, const Polygons& polygons) {
    Mesh mesh;
    mesh.V.resize(static_cast<Eigen::Index>(points.size()), 3);
    for (std::size_t v = 0; v < points.size(); ++v)
        mesh.V.row(static_cast<Eigen::Index>(v)) << points[v].x(), points[v].y(), points[v].z();
    std::vector<std::size_t> corners;
    for (const auto& polygon : polygons)
        for (std::size_t k = 2; k < polygon.size(); ++k)
            corners.insert(corners.end(), {polygon[0], polygon[k - 1], polygon[k]});
    mesh.F.resize(static_cast<Eigen::Index>(corners.size() / 3), 3);
    for (std::size_t c = 0; c < corners.size(); ++c) mesh.F.data()[c] = static_cast<std::int32_t>(corners[c]);
    return mesh;
}

Mesh read_mesh(const std::string& file) {
    if (!std::filesystem::is_regular_file(file)) throw toile::InputError(file + ": no such file");
    std::vector<Point> points;
    Polygons polygons;
    const bool read = CGAL::IO::read_polygon_soup(file, points, polygons);
    toile::require(read && !polygons.empty(), file + ": not a mesh in OBJ, PLY, OFF or STL");
    toile::require(points.size() <= std::numeric_limits<std::int32_t>::max(), file + ": too many vertices");
    const Mesh mesh = triangles(points, polygons);
    toile::check_mesh(file, mesh.V, mesh.F, "vertices", "faces");
    return mesh;
}

void write_obj(const std::string& file, const Mesh& mesh) {
    std::vector<Point> points;
    for (const auto& p : mesh.V.rowwise()) points.emplace_back(p[0], p[1], p[2]);
    Polygons polygons;
    for (const auto& f : mesh.F.rowwise())
        polygons.push_back({std::size_t(f[0]), std::size_t(f[1]), std::size_t(f[2])});
    if (!CGAL::IO::write_OBJ(file, points, polygons, CGAL::parameters::stream_precision(17)))
        throw toile::InputError(file + ": cannot be written");
}

/// Mean distance of points to a surface, in the unit of the files.
double mean_distance(const toile::Vertices& points, const Mesh& surface) {
    double sum = 0;
    for (const auto& p : toile::SurfaceIndex(surface.V, surface.F).closest_each(points)) sum += p.distance;
    return sum / static_cast<double>(points.rows());
}

void register_mesh(const std::string& template_file, const std::string& scan_file, const std::string& out,
                   const std::string& preset) {
    const toile::NricpOptions options = toile::nricp_preset(preset);
    Mesh mesh = read_mesh(template_file);
    const Mesh scan = read_mesh(scan_file);
    toile::NricpFrame frame;
    frame.V = scan.V;
    frame.F = scan.F;
    const toile::NricpResult result = toile::NricpSolver(mesh.V, mesh.F, options).solve(frame);
    if (result.stop == toile::Stop::no_overlap)
        throw toile::SolveError(scan_file + ": the template lies nowhere near the scan");
    mesh.V = result.V;
    write_obj(out, mesh);
    std::printf("%s: %d iterations, %s; vertices lie %.3g from the scan on average\n", out.c_str(), result.iterations,
                toile::name(result.stop).data(), mean_distance(mesh.V, scan));
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 4 && argc != 5) {
        std::fprintf(stderr, "usage: register_mesh TEMPLATE SCAN OUT.obj [draft|standard|fine]\n");
        return 1;
    }
    try {
        register_mesh(argv[1], argv[2], argv[3], argc == 5 ? argv[4] : "standard");
    } catch (const std::exception& error) {
        std::fprintf(stderr, "register_mesh: %s\n", error.what());
        return 1;
    }
}
