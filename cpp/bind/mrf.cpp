#include "bind/common.h"

namespace toile::bind {

void bind_mrf(py::module_&) {}

}  // namespace toile::bind
