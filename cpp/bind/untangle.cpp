#include "bind/common.h"

namespace toile::bind {

void bind_untangle(py::module_&) {}

}  // namespace toile::bind
