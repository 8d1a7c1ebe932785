if(TARGET gleaner_film)
  find_package(PNG REQUIRED)
  gleaner_test(NAME film SOURCES film_test.cpp film_metrics_test.cpp film_shrink_test.cpp LIBRARIES gleaner_film PNG::PNG)
endif()
