# Debian's own OpenImageIOConfig.cmake insists on the programs of openimageio-tools and all that they pull in; the
# library alone is what is needed here.
find_path(OpenImageIO_INCLUDE_DIR OpenImageIO/imageio.h)
find_library(OpenImageIO_LIBRARY OpenImageIO)
find_library(OpenImageIO_Util_LIBRARY OpenImageIO_Util)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(OpenImageIO REQUIRED_VARS OpenImageIO_LIBRARY OpenImageIO_Util_LIBRARY
                                                            OpenImageIO_INCLUDE_DIR)
if(OpenImageIO_FOUND AND NOT TARGET OpenImageIO::OpenImageIO)
  add_library(OpenImageIO::OpenImageIO INTERFACE IMPORTED)
  set_target_properties(
    OpenImageIO::OpenImageIO
    PROPERTIES INTERFACE_INCLUDE_DIRECTORIES ${OpenImageIO_INCLUDE_DIR}
               INTERFACE_LINK_LIBRARIES "${OpenImageIO_LIBRARY};${OpenImageIO_Util_LIBRARY}")
endif()
